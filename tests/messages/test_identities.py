"""Whose a key is, and who can be a user."""

import pytest
from hypothesis import given, strategies as st

from guidefield.errors import MalformedRequest
from guidefield.messages.identities import PLAIN, base_key, check_user, split_user

USERS = st.from_regex(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}", fullmatch=True).filter(lambda user: user != PLAIN)
CHUNKS = st.lists(st.from_regex(r"[a-z0-9]{1,8}", fullmatch=True), min_size=1, max_size=3).filter(
    lambda chunks: chunks[0] != "as"
)


@given(USERS, CHUNKS)
def test_a_key_below_a_users_is_that_users_and_every_other_one_is_plain(user: str, chunks: list[str]) -> None:
    for asking in (user, PLAIN):
        key = f"{base_key('cell', asking)}/{'/'.join(chunks)}"
        assert split_user(key.split("/")[2:]) == (asking, tuple(chunks))


@pytest.mark.parametrize("user", ["", "plain", ".hidden", "a/b", "a:b", "*", "a b", "x" * 65, "ä"])
def test_nobody_can_be_called_what_is_no_chunk_no_folder_or_another_identity(user: str) -> None:
    with pytest.raises(MalformedRequest, match="must be 1 to 64 of the characters"):
        check_user(user)
    with pytest.raises(MalformedRequest):
        split_user(["as", user, "plan"])
