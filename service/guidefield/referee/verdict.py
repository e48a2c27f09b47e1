"""The verdicts of the referee about a motion, and their words."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator
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
    """One answer, and where."""

    answer: Answer  # the verdict
    # two bodies, or the joint and its limit, or a constraint, or what can't be judged; empty where all is free
    about: tuple[str, ...] = ()
    time: float = math.nan  # when [s]; along a path, how many segments in
    distance: float = math.nan  # of the bodies there [m]; by how much a limit or constraint is exceeded


@dataclass(frozen=True)
class Verdict:
    """What was found, and what it rests on."""

    finding: Finding  # the answer, and where
    # what all pairs are proven to keep beyond what was asked for, as far as they were judged [m]
    kept: float = math.inf
    pairs: int = 0  # how many pairs were judged
    left_out: tuple[tuple[str, str, str], ...] = ()  # two names and a reason: pairs about which nothing is said
    evaluations: int = 0  # distances that Coal was asked for, or slabs of a proof

    @property
    def answer(self) -> Answer:
        """The verdict in a word."""
        return self.finding.answer


def lines(verdict: Verdict, rests_on: str = "distances") -> Iterator[str]:
    """The verdict, what it rests on, and every pair that was left out, a line each."""
    found = verdict.finding
    about = ("; " if found.answer is Answer.NOT_JUDGED else " and ").join(found.about)
    when = "" if math.isnan(found.time) else f" at {found.time:.6g}"
    how_far = "" if math.isnan(found.distance) else f", {found.distance:.9g}"
    yield f"referee: {found.answer.value}" + (f": {about}{when}{how_far}" if about else "")
    if found.answer is Answer.FREE:
        kept = "" if math.isinf(verdict.kept) else f"; they keep {verdict.kept:.3g} m more than that at least"
        yield f"{verdict.pairs} pairs, {verdict.evaluations} {rests_on}{kept}"
    yield f"pairs left out: {len(verdict.left_out)}"
    for first, second, why in sorted(verdict.left_out):
        yield f"  {first} and {second}: {why}"
