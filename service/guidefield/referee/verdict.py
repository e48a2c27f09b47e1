"""What the referee says of a motion."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass


class Answer(enum.Enum):
    """The verdict in a word."""

    FREE = "free"
    CONTACT = "contact"
    TOO_CLOSE = "closer than required"
    INSIDE = "inside a closed mesh at the start"
    BEYOND_LIMIT = "beyond a limit"
    CONSTRAINT_BROKEN = "a path constraint is broken"
    FALSE_PART = "a convex part or closed shell is not that of its mesh"
    NOT_PROVED = "the proof doesn't hold"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class Finding:
    """One answer, and where.

    Attributes:
        answer: The verdict.
        about: Two bodies, or the joint and its limit, or a constraint, or what can't be judged; empty where all is
            free.
        time: When [s]; along a path, how many segments in.
        distance: Of the bodies there [m]; by how much a limit or constraint is exceeded.
    """

    answer: Answer
    about: tuple[str, ...] = ()
    time: float = math.nan
    distance: float = math.nan


@dataclass(frozen=True)
class Verdict:
    """What was found, and what it rests on.

    Attributes:
        finding: The answer, and where.
        kept: What all pairs are proven to keep beyond what was asked for, as far as they were judged [m].
        pairs: How many pairs were judged.
        left_out: Two names and a reason: pairs about which nothing is said.
        evaluations: Distances that Coal was asked for, or slabs of a proof.
    """

    finding: Finding
    kept: float = math.inf
    pairs: int = 0
    left_out: tuple[tuple[str, str, str], ...] = ()
    evaluations: int = 0

    @property
    def answer(self) -> Answer:
        """The verdict in a word."""
        return self.finding.answer
