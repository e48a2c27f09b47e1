"""Scratch data is one borrower's alone, and lent on when that is gone."""

from __future__ import annotations

from guidefield.robot.group.kinematics import MOST, lent_data
from tests.robots import group


class Borrower:
    """Who holds nothing else."""


def test_data_is_lent_on_only_when_its_borrower_is_gone() -> None:
    planned, borrowers = group("panda"), [Borrower() for _ in range(MOST + 2)]
    lent = [lent_data(planned, borrower) for borrower in borrowers]
    assert len({id(one) for one in lent}) == len(lent)
    last = id(lent.pop())
    del borrowers[-1]
    assert id(lent_data(planned, borrowers[0])) == last
    other = lent_data(planned, borrowers[1])
    assert all(other is not one for one in lent)
