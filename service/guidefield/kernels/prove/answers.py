"""Questions about the smallest distance of some pairs within some time, and what is known of their answers."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.prove.tables import MovingRobot

SINCE, UNTIL, OWN, DISTANCE, TIME, PAIR, BOUND, ANSWER = range(8)
"""Numbers of a question, from when until when [s] and whether about own pairs, 1, or others, 0; and of its answer: the
smallest distance [m], when [s], which pair, and what all keep at least [m]; then how many numbers there are."""

NEARLY = 1e-5
"""What is nearly touching [m]."""


@uncounted
def least_asked(answers: Floats, own: int, since: float, until: float, tolerance: float) -> float:
    """What pairs, own ones or not, have to keep between two times so that no answer is more than a tolerance too large.

    Answers have the shape (q, ANSWER), here and below.

    Minus infinity where nothing is asked; else no less than 0: what overlaps isn't told from what touches.
    """
    least = -np.inf
    for q in range(answers.shape[0]):
        if since < answers[q, UNTIL] and until > answers[q, SINCE] and answers[q, OWN] == own:
            least = max(least, answers[q, DISTANCE] - tolerance, 0.0)
    return least


@uncounted
def keep(answers: Floats, own: int, time: float, distance: float, pair: int) -> None:
    """Keep a distance of a pair, an own one or not, where it is smaller than all before; answers (q, ANSWER)."""
    for q in range(answers.shape[0]):
        if is_about(answers, q, own, time) and distance < answers[q, DISTANCE]:
            answers[q, DISTANCE], answers[q, TIME], answers[q, PAIR] = distance, time, pair


@uncounted
def is_about(answers: Floats, q: int, own: int, time: float) -> bool:
    """Whether a question, one of (q, ANSWER), is about own pairs, or about others, at a time."""
    return bool(answers[q, SINCE] <= time <= answers[q, UNTIL] and answers[q, OWN] == own)


@uncounted
def is_own(moving: MovingRobot, pair: int) -> int:
    """Whether a pair is one of the robot's own, 1 or 0."""
    return 1 if pair < moving.pairs.first_by.shape[0] else 0


@uncounted
def may_improve(answers: Floats, own: int, time: float, distance: float) -> float:
    """The largest of answers (q, ANSWER) about own pairs, or others, at a time that is above a distance; else -inf."""
    most = -np.inf
    for q in range(answers.shape[0]):
        if is_about(answers, q, own, time) and distance < answers[q, DISTANCE]:
            most = max(most, answers[q, DISTANCE])
    return most


@uncounted
def nearly_touch(answers: Floats) -> bool:
    """Whether one of answers (q, ANSWER) is that bodies touch, or nearly."""
    least = np.inf
    for q in range(answers.shape[0]):
        least = min(least, answers[q, DISTANCE])
    return bool(least <= NEARLY)
