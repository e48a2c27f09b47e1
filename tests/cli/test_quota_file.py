"""The file with what each user may have."""

from pathlib import Path

import pytest

from guidefield.cli.serving import read_quotas
from guidefield.errors import MalformedRequest
from guidefield.messages.identities import Quota


def test_what_it_says_holds_for_whom_it_names(tmp_path: Path) -> None:
    file = tmp_path / "quotas.json"
    file.write_text(
        '{"plain": {"waiting": 8}, "default": {"per_second": 20}, "users": {"alice": {"processor_per_minute": 30}}}'
    )
    quotas = read_quotas(file)
    assert quotas.of("plain") == Quota(waiting=8)
    assert quotas.of("alice") == Quota(processor_per_minute=30.0)
    assert quotas.of("bob") == Quota(per_second=20.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "quotas.json"),
        ('{"user": {}}', "did you mean `users`"),
        ('{"plain": {"waiting": 0}}', "plain.waiting"),
        ('{"default": {"per_second": -1}}', "default.per_second"),
        ('{"default": {"bytes": 0}}', "default.bytes"),
        ('{"users": {"plain": {}}}', "user 'plain' must be"),
        ('{"users": {"a/b": {}}}', "user 'a/b' must be"),
    ],
)
def test_a_mistake_in_it_is_told_with_its_place(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "quotas.json"
    file.write_text(text)
    with pytest.raises(MalformedRequest, match=says):
        read_quotas(file)
