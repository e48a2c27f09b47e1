"""A slice of `tools/attack_deadlines`: answers come in time however large what is given, and however it is given."""

from __future__ import annotations

import pytest

from tests.deadline_attack import FORMS, MAKERS, TIMES, late, too_late

SHARE = 0.2
"""Of the largest scenes: reading one takes from 5 to 100 ms, and building it more."""


@pytest.mark.parametrize("allowed", TIMES)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", MAKERS)
def test_an_answer_comes_in_time(kind: str, form: str, allowed: float) -> None:
    for seconds, ended in late(kind, form, allowed * SHARE, again=1, share=SHARE):
        assert not too_late(seconds, allowed), ended
