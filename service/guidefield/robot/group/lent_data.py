"""Scratch data of Pinocchio's, lent: for a chain of 48 ball joints new data takes as long as half a search."""

from __future__ import annotations

import weakref
from typing import Any

from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup

MOST = 3
"""Of alike groups no more are kept that nobody has: a plan needs as many."""


def lent_data(group: PlanningGroup, borrower: object) -> Any:
    """Data of a group's model, `pinocchio.Data`, the borrower's alone as long as that lives; what it holds is old.

    Args:
        group: The group.
        borrower: Whoever overwrites it; what is seen of the data must not outlive it.
    """
    unused = _unused(group)
    try:
        data = unused.pop()
    except IndexError:
        data = group.model.createData()
    weakref.finalize(borrower, _taken_back, unused, data).atexit = False
    return data


@memoized_for_alike
def _unused(group: PlanningGroup) -> list[Any]:  # noqa: ARG001 - they are its model's
    """Data that nobody has."""
    return []


def _taken_back(unused: list[Any], data: Any) -> None:
    if len(unused) < MOST:
        unused.append(data)
