"""Tables of a robot, of obstacles at rest and in motion, of the pairs between them, and of a motion; rows of answers.

`prove/tables.py` and `stream/obstacles.py` fill them, all kernels of this folder read them. `prove/search.py` and
`stream/commit.py` write and read columns of questions and verdicts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.near_pairs import BoxedObstacles
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.arrays import Blocks, Floats, IndexRows, Indices, Row, Rows
from guidefield.kernels.jit.decorators import uncounted
from guidefield.kernels.kinematics.forward_kinematics import JointTable


class RobotBodies(NamedTuple):
    """A robot's bodies and the joints that move them; r bodies, n local coordinates of the model with mimic ones."""

    joints: JointTable  # joints of the model
    expand: Rows  # the model's local coordinates by those of the group, shape (n, nv); with `offset`
    offset: Row  # shape (n,) [rad or m]
    origin: Row  # configuration of the model from which rotation vectors start, shape (nq,)
    half_widths: Rows  # the sizes of `expand`, shape (n, nv)
    alone: Row  # 1 for a coordinate that makes a move of its own, shape (n,)
    together: Rows  # coordinates that make one move, counted in its first, shape (n, n)
    centred: Rows  # the same for turns about a centre, halved, shape (n, n)
    turns: Row  # 1 for a coordinate that turns, 0 for one that slides, shape (n,)
    doubled: Row  # 2 for the first coordinate of a ball joint's rotation, else as `turns`, shape (n,)
    parent_joints: Indices  # joint of each body, shape (r,); 0 is the world
    centres: Rows  # centre of its bounding sphere in the frame of that joint, shape (r, 3) [m]
    radii: Row  # radius of the sphere, shape (r,) [m]
    moved_by: IndexRows  # the coordinates that move a body, ascending, and -1 behind them, shape (r, n)
    moves: Rows  # 1 for a coordinate that moves a body, -1 for another, shape (r, n)
    roots: Indices  # root of each in `parts`, shape (r,), in the frame of its joint
    parts: Parts  # their convex parts; those of bodies that the world carries as seen from the anchor
    anchor: Row  # a point near those bodies, along the world's axes, shape (3,) [m]


class ObstacleBodies(NamedTuple):
    """Obstacles where they are at first; o of them."""

    boxes: BoxedObstacles  # boxes about them, those that move apart from the tree
    roots: Indices  # root of each in `parts`, shape (o,)
    parts: Parts  # their convex parts, as seen from the anchor; half-spaces in the world
    anchor: Row  # a point near them, along the world's axes, shape (3,) [m]
    movers: Indices  # index of each among those that move, -1 for one at rest, shape (o,)


class MovingObstacles(NamedTuple):
    """Obstacles on screws from each of their placements to the next, at rest before the first and after the last."""

    begins: Indices  # begin of the placements of each, and the number of all, shape (v + 1,)
    times: Row  # times of the placements, shape (k,) [s]
    # motions from where an obstacle is at first to each placement, rotation and translation row by row, shape (k, 12)
    # [m, world]
    poses: Rows
    twists: Rows  # twist from a placement to the next, linear part first, shape (k, 6) [m/s and rad/s, world]
    speeds: Row  # largest speed at which distances to the obstacle change, shape (k,) [m/s]
    endless: Indices  # 1 for one without an end, shape (v,)
    # margins, growths, since: What is kept from each in addition, as it may have left its motion: at first [m], and for
    # each second [m/s] since a time [s]; each of shape (v,)
    margins: Row
    growths: Row
    since: Row


class BodyPairs(NamedTuple):
    """Pairs that must stay apart, and how the bodies of the robot's own are seen from each other."""

    # own, moving, left_out: As `near_pairs.PairTable` has them
    own: IndexRows
    moving: Indices
    left_out: Indices
    # the coordinates that move the first body of an own pair as it is seen from some body between both, in order from
    # there to it, and -1 behind them, shape (p, n)
    first_by: IndexRows
    second_by: IndexRows  # the same of the second, shape (p, n)


class BezierCurve(NamedTuple):
    """A motion as Bezier curves in the group's local coordinates; k of them."""

    times: Row  # parameters at which they begin and the last one ends, increasing, shape (k + 1,)
    clock: Row  # the time at each of those, for obstacles that move, shape (k + 1,) [s]
    positions: Blocks  # control points, shape (k, order, nv) [rad or m]
    tube: Rows  # how far the robot may be beside each of them, in each coordinate, shape (k, nv) [rad or m]


class MovingRobot(NamedTuple):
    """A robot that moves among obstacles."""

    robot: RobotBodies
    obstacles: ObstacleBodies
    movers: MovingObstacles  # how those of them move that do
    pairs: BodyPairs  # the pairs that must stay apart
    curve: BezierCurve


@uncounted
def is_own(pairs: BodyPairs, pair: int) -> int:
    """Return 1 for one of the robot's own pairs, 0 for another."""
    return 1 if pair < pairs.own.shape[0] else 0


@uncounted
def first_body(pairs: BodyPairs, obstacles: ObstacleBodies, pair: int) -> int:
    """Return the robot body of a pair: of an own one the first."""
    own = pairs.own.shape[0]
    if pair < own:
        return int(pairs.own[pair, 0])
    return int(pairs.moving[(pair - own) // obstacles.roots.shape[0]])


@uncounted
def obstacle_of(pairs: BodyPairs, obstacles: ObstacleBodies, pair: int) -> int:
    """Return the obstacle of a pair that has one."""
    return int((pair - pairs.own.shape[0]) % obstacles.roots.shape[0])


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

FREE, IN_CONTACT, TOO_CLOSE, UNDECIDED = range(4)  # reasons; at one place contact comes before too close, as less
NEARLY = 1e-5  # what is closer Coal measures, as kernels find no depth, or is contact [m]: above `SLACK` + `ACCURACY`


@uncounted
def is_judged(verdict: Floats, kind: int) -> bool:
    """Tell if a kind of pairs counts for a verdict (VERDICT,)."""
    return (int(verdict[KINDS]) & kind) != 0


@uncounted
def required_distance(
    questions: Floats, verdict: Floats, own: int, since: float, until: float, tolerance: float
) -> float:
    """Return the distance that pairs, own ones or others, have to keep between two parameters [m].

    It is at least 0: what overlaps isn't told from what touches; minus infinity where nothing is asked for. Questions
    (q, ANSWER), verdict (VERDICT,); an answer may be too large by `tolerance` [m].
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
    """Tell if a question, one of (q, ANSWER), is about own pairs, or about others, at a parameter."""
    return bool(questions[q, SINCE] <= at <= questions[q, UNTIL] and questions[q, OWN] == own)


@uncounted
def largest_answer_above(questions: Floats, own: int, at: float, distance: float) -> float:
    """Return the largest answer, of (q, ANSWER), above a distance of own pairs, or others, at a place; else -inf."""
    most = -np.inf
    for q in range(questions.shape[0]):
        if is_about(questions, q, own, at) and distance < questions[q, DISTANCE]:
            most = max(most, questions[q, DISTANCE])
    return most
