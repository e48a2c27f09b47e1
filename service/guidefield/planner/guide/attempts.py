"""How each guide plane is tried, and tried again, with the minimizer that a request asks for."""

from __future__ import annotations

from guidefield.errors import InvalidGroup
from guidefield.planner.guide.guide import PROJECTED
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.guide.settings import APPROACH
from guidefield.planner.guide.univariate import Univariate
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.link_chain import link_chain


def projected(group: PlanningGroup) -> tuple[Attempt, ...]:
    """Projected in one block, in two, with shorter advances; then, where it is for such a robot, Univariate."""
    try:
        chain = link_chain(group)
    except InvalidGroup:
        return PROJECTED
    return (*PROJECTED, Attempt(Univariate(chain), APPROACH.first_step, careful=True))


def univariate(group: PlanningGroup) -> tuple[Attempt, ...]:
    """Univariate, then with shorter advances.

    Raises:
        InvalidGroup: if the group isn't a chain of ball or universal joints.
    """
    minimizer = Univariate(link_chain(group))
    step = APPROACH.first_step
    return Attempt(minimizer, step, careful=True), Attempt(minimizer, step / 2, careful=True)


ATTEMPTS = {"projected": projected, "univariate": univariate}
"""By the name that a request gives."""
