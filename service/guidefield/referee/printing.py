"""What the referee found, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator

from guidefield.referee.verdict import Answer, Verdict


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
