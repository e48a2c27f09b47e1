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


def test_of_what_comes_back_few_are_kept() -> None:
    planned, borrowers = group("ur5"), [Borrower() for _ in range(MOST + 2)]
    lent = [lent_data(planned, borrower) for borrower in borrowers]
    borrowers.clear()
    again = [Borrower() for _ in range(MOST + 2)]
    known = {id(one) for one in lent}
    found = [lent_data(planned, borrower) for borrower in again]
    assert sum(id(one) in known for one in found) == MOST
