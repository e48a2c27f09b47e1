"""Questions about a motion: the smallest distances within spans of it, and a verdict; and how far they are answered."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats

SINCE, UNTIL, OWN, DISTANCE, TIME, PAIR, BOUND, ANSWER = range(8)
"""Columns of a question about the smallest distance: the parameters between which, and whether about own pairs, 1, or
others, 0; and of its answer: the distance [m], its parameter, its pair, a certified lower bound [m]; then their number.
"""

KINDS, MARGIN, STAND_OFF, ERROR, RESOLUTION, END, REASON, PLACE, CULPRIT, SEGMENTS, VERDICT = range(11)
"""Numbers of a verdict: the sum of the kinds of pairs that are judged, what pairs with obstacles have to keep [m], how
much more is proved of all pairs, as a judge of single configurations may be off by so much [m], what arithmetic may be
off by [m], the motion of a pair below which it is undecided [m], negative where no verdict is asked for; the parameter
up to which the motion is free, the reason and the place of the refusal, its pair, the number of segments that were
judged; then how many there are."""

OWN_PAIRS, AT_REST, IN_MOTION = 1, 2, 4
"""Kinds of pairs: of the robot itself, with obstacles at rest, and with those that move."""

FREE, IN_CONTACT, TOO_CLOSE, UNDECIDED = range(4)
"""Reasons."""

NEARLY = 1e-5
"""Bodies closer than this are measured by Coal: kernels find no depth [m]."""


@uncounted
def is_judged(verdict: Floats, kind: int) -> bool:
    """Whether a kind of pairs counts for a verdict, shape (VERDICT,)."""
    return (int(verdict[KINDS]) & kind) != 0


@uncounted
def required_distance(
    questions: Floats, verdict: Floats, own: int, since: float, until: float, tolerance: float
) -> float:
    """Return the distance that pairs, own ones or others, have to keep between two parameters [m].

    It is at least 0: what overlaps isn't told from what touches. Minus infinity where nothing is asked for.

    Args:
        questions: Shape (q, ANSWER).
        verdict: Shape (VERDICT,).
        own: 1 for own pairs, 0 for others.
        since: The one parameter.
        until: The other.
        tolerance: By how much an answer may be too large [m].
    """
    least = -np.inf
    for q in range(questions.shape[0]):
        if (
            since < questions[q, UNTIL]
            and until > questions[q, SINCE]
            and questions[q, OWN] == own
            and questions[q, DISTANCE] > 0.0
        ):
            least = max(least, questions[q, DISTANCE] - tolerance, 0.0)
    if verdict[RESOLUTION] >= 0.0 and since < verdict[END]:
        least = max(least, margin_of(verdict, own) + verdict[STAND_OFF])
    return least


@uncounted
def margin_of(verdict: Floats, own: int) -> float:
    """Return what own pairs, or others, have to keep for a verdict, shape (VERDICT,) [m]."""
    return 0.0 if own == 1 else float(verdict[MARGIN])


@uncounted
def keep(questions: Floats, own: int, at: float, distance: float, pair: int) -> None:
    """Note a distance of a pair, an own one or not, where it is the smallest so far; questions (q, ANSWER)."""
    for q in range(questions.shape[0]):
        if is_about(questions, q, own, at) and distance < questions[q, DISTANCE]:
            questions[q, DISTANCE], questions[q, TIME], questions[q, PAIR] = distance, at, pair


@uncounted
def refuse(verdict: Floats, own: int, at: float, distance: float, pair: int) -> None:
    """Note in a verdict (VERDICT,) that a pair, an own one or not, is so far apart at a parameter [m]."""
    if verdict[RESOLUTION] < 0.0 or distance > margin_of(verdict, own) or at > verdict[END]:
        return
    reason = IN_CONTACT if distance <= 0.0 else TOO_CLOSE
    # of what is found at one place contact counts first
    if at < verdict[END] or verdict[REASON] == FREE or (verdict[PLACE] == at and reason < verdict[REASON]):
        verdict[END], verdict[REASON], verdict[PLACE], verdict[CULPRIT] = at, reason, at, pair


@uncounted
def is_about(questions: Floats, q: int, own: int, at: float) -> bool:
    """Whether a question, one of (q, ANSWER), is about own pairs, or about others, at a parameter."""
    return bool(questions[q, SINCE] <= at <= questions[q, UNTIL] and questions[q, OWN] == own)


@uncounted
def largest_answer_above(questions: Floats, own: int, at: float, distance: float) -> float:
    """Return the largest answer, of (q, ANSWER), above a distance of own pairs, or others, at a place; else -inf."""
    most = -np.inf
    for q in range(questions.shape[0]):
        if is_about(questions, q, own, at) and distance < questions[q, DISTANCE]:
            most = max(most, questions[q, DISTANCE])
    return most
