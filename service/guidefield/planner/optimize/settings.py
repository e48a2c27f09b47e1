"""The numbers of the optimisation of motions, each with what chose it; `tools/bench quality --poses` measures them.

Lengths are those at size 1, see `scale_to_size`; a coordinate in metres counts by the robot's size, too.

"Problems" are 35 of the public ones of a Panda as pose goals, at 15 rad/s² and 500 rad/s³. Where it says *unrecorded*
nobody wrote down how a number was chosen; a prototype's were chosen on 70 of the same sets, some of which are measured
now. Other constants stand beside their use; service/docs/algorithm.md repeats some, docs/steps.md `MANY`. All change
motions, the time to find them and how often they are refused: whether they are free is certified afterwards
(`planner/optimized_motion.py`), limits of rates are kept anyway. `piece` stays above 0.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from guidefield.planner.task.problem import Objective


@dataclass(frozen=True)
class OptimizationSettings:
    """The settings of an optimisation."""

    # weight of the mean barrier against the duration, which counts from 1. Problems: with 0.05 motions are 1 % faster
    # and keep 2 mm less on the way, with 0.2 1 % slower and 2 mm more
    weight: float = 0.1
    range: float = 0.08  # of the barrier, and `distance` of slices.py [m]. With 120 mm motions get 10 % slower
    end_weight: float = 0.0  # weight on top of the full one at an end, against the tighter range
    # what is nearer to obstacles than this beyond the required clearance costs more, far from the ends [m]. With 2 mm
    # instead two of 70 motions came nearer than 20 mm
    floor: float = 0.045
    # with much room at both ends it is `clearance_samples.FLOOR_SHARE` of that, at most this [m]
    farthest_floor: float = 0.045
    least_floor: float = 0.002  # the same at least, at ends [m]: as `MARGIN` of robot/model/model.py
    samples: int = 2  # on a piece before the last subdivision. Problems: with three motions keep as much
    fine_samples: int = 1  # the same after it. Problems: with two motions keep as much, in twice the time
    # whether few of the points of a motion that passes something count after it too. Guided chains keep as much with a
    # third of them; a Panda at a door that moves kept 13 mm of 32
    few: bool = False
    piece: float = 0.18  # length of a piece before the last subdivision [rad or m]. Unrecorded
    least_pieces: int = 16  # at least and at most this many. With 24 for 64 four of 21 motions of a Fetch were refused
    most_pieces: int = 64  # together with the one above
    rough: tuple[float, ...] = ()  # weights of the limits' barrier before those of `coarse`, with half the pieces
    # weights of the limits' barrier, one after the other, until pieces are subdivided. Problems: 3e-3 and 3e-4 besides
    # take more steps to the same motions
    coarse: tuple[float, ...] = (1e-2, 1e-3)
    fine: tuple[float, ...] = (1e-4, 1e-5)  # the same after that. Problems: 1e-5 alone keeps 0.5 mm less
    # what an evaluation of the clearance has to bring at a weight for another one, and what that one is promised to
    # bring, as a share of the objective, against the root of the weight; see `free`
    worth: float = 0.0
    stiffness: float = 1.0  # share of Gauss and Newton's Hessian of the clearance that the first model has; see `free`
    least_stiffness: float = 1.0  # at least so much of it is left
    newton_steps: int = 8  # between two evaluations, at most. Problems: with 1 a quarter more evaluations are taken
    # Newton's method ends where a step brought less than this share of the objective. Problems: with 0 it takes more
    # steps between a tenth fewer evaluations, with 1e-2 more evaluations, in the same time
    little: float = 3e-3
    shorter: float = 0.8  # a step beyond limits, or that brings nothing, is tried again this much shorter. Unrecorded
    # a step that promises less than this share of the objective is not taken. With 3e-4 motions are 0.1 % faster and
    # take a quarter more steps
    settled: float = 5e-4
    longest: float = 0.5  # most that a coordinate moves in one step [rad or m], and the departure [s]. Unrecorded
    # of several first motions the next one is optimised coarsely only while the best takes more than this times what a
    # straight motion takes. With 1.08, as for `time`, balanced motions in cages take 4 % less, and their plans a
    # quarter more time
    enough: float = 1.25
    # change of what a passage is missed by in a piece before the last subdivision, below which a change of time makes
    # up for little; half as much after it [m or rad]; see `for_guide_planes`
    crossing: float = 2e-3
    # of half the mean of squares of what loads are beyond a share, see `loads`: by its problems motions are 1 % slower
    # with 5, and with 60 0.5 % faster in a tenth more time
    load_weight: float = 20.0


BALANCED = OptimizationSettings()

HEAVIER_LOADS = 20.0  # factor on the weight of loads beyond their limits, twice at most; see `for_unscaled_time`

OPTIMIZATION: Mapping[Objective, OptimizationSettings] = MappingProxyType(
    {
        Objective.BALANCED: BALANCED,
        Objective.TIME: dataclasses.replace(BALANCED, weight=0.05, fine=(1e-4, 3e-5, 1e-5), enough=1.08),
        Objective.CLEARANCE: dataclasses.replace(BALANCED, weight=0.3, end_weight=30.0, farthest_floor=0.25),
    }
)
"""Settings by objective; connect.py has its number of paths. For `CLEARANCE`, by 56 problems of a Panda, 20 of a UR5
and 13 of a Fetch with configurations as goals: with less weight at the ends motions come up to 6 mm nearer than their
ends, with more on the whole way they take up to five times as long for 2 mm."""


def scale_to_size(settings: OptimizationSettings, size: float) -> OptimizationSettings:
    """Scale the distances that a motion keeps from obstacles by the robot's size."""
    if size == 1.0:
        return settings
    lengths = ("range", "floor", "farthest_floor", "least_floor")
    return dataclasses.replace(settings, **{name: size * getattr(settings, name) for name in lengths})


MANY = 24  # motions of more coordinates are optimised `of_many`, and past goals not at all


def of_many(settings: OptimizationSettings) -> OptimizationSettings:
    """For a motion of many coordinates.

    One of Newton's steps takes work with their third power, and an evaluation of the clearance with their second; a
    chain's length in them grows with their number, though its shape needs no more pieces. By the thesis' tapered
    passage and its tubes, for chains of 12 and 24 links: with 64 pieces the optimisation takes two to three times as
    long, for motions that are 2 % shorter to 6 % longer and keep 3 mm more to 17 less; with 12 some are refused at
    first. With longer steps up to twice as many evaluations are taken, as most prove too long; with more of them
    between two evaluations Newton's method takes up to twice as long; with 1e-4 and 1e-5 in place of one last weight up
    to half as long again. Motions are the same with all of these to 2 mm and 0.2 % of their time.
    """
    few = settings.least_pieces
    return dataclasses.replace(settings, most_pieces=few, newton_steps=1, longest=0.05, fine=(3e-5,))


@functools.cache
def free(settings: OptimizationSettings) -> OptimizationSettings:
    """For a motion that keeps no path constraints, of up to `MANY` coordinates, and passes nothing among what rests.

    The Hessian of its clearance is mostly too stiff: with all of it many evaluations bring little, one after the other.
    On 78 problems of a Panda, a UR5, a Fetch and a Baxter 0.61, 0.67, 0.47 and 0.34 of the evaluations are taken, to
    motions that take 1.00, 1.00, 0.96 and 0.92 of the time and keep 1 mm less to 7 mm more. Motions that cross guide
    planes get up to 16 % longer with it; among obstacles that move 0.4 and 4 % (door.json, conveyor.json), in half the
    time.
    """
    return dataclasses.replace(settings, worth=0.4, stiffness=0.5, least_stiffness=0.3)


@functools.cache
def in_few_pieces(settings: OptimizationSettings) -> OptimizationSettings:
    """The same from rest to rest among what rests: it begins with half the pieces, which are subdivided twice.

    While limits weigh much a motion's shape needs few pieces, and Newton's steps and evaluations of the clearance take
    time with their number. With less of `little` there are fewer evaluations, with less of `worth` more (with 0.25 a
    twentieth fewer, and motions of a UR5 that take 0.2 % longer on 168 problems), and motions that keep a millimetre
    less without more weight. On 181 problems of a Panda, 30 of which in cages, a UR5, a Fetch and a Baxter
    samples are examined 0.81, 0.80, 0.82, 0.85 and 0.82 times as often, for motions that take 1.00 of the time and
    keep 0.3 mm less, 0.2 more, 0.6 less, 1.4 more and 0.8 less in the mean. Tried without
    gain: a third of the points until then, a Hessian that is scaled by secants for each sample, pieces chosen anew by
    the length of the motion, the Hessian of the weight before in the first step after it falls.
    """
    return dataclasses.replace(
        settings,
        weight=1.08 * settings.weight,
        piece=2.0 * settings.piece,
        least_pieces=settings.least_pieces // 2,
        most_pieces=settings.most_pieces // 2,
        rough=settings.coarse,
        coarse=settings.fine[:1],
        fine=settings.fine[1:],
        little=1e-3,
        worth=0.2,
    )


def in_space(settings: OptimizationSettings) -> OptimizationSettings:
    """For a motion that keeps limits of speed in space: its shape changes much, by many evaluations that bring little.

    On 30 problems of a Panda as pose goals, with 0.25 m/s for its hand, 1.0 has a seventh more evaluations for motions
    that take as long, 3.0 a tenth fewer for motions that take 0.4 % longer, and without this 57 for 23, for 2 % less.
    """
    return dataclasses.replace(settings, worth=2.0)


def for_unscaled_time(settings: OptimizationSettings) -> OptimizationSettings:
    """Return settings for a motion that has to keep limits of the whole by itself: its time isn't scaled in the end."""
    return dataclasses.replace(settings, load_weight=HEAVIER_LOADS * settings.load_weight)


LONG = 2.0  # `for_long_motion` is for motions that would take more than this times the largest number of pieces


def for_long_motion(settings: OptimizationSettings, length: float) -> OptimizationSettings:
    """Return settings with few pieces for a motion of a length [rad or m], which may be a drive through many rooms.

    Its pieces are as long as usual, though there are many; and what a change there brings is a small share of the whole
    objective. Without it eight of nine drives of a Fetch through doors of 1 m, 30 to 96 m long, were not certified;
    with shares divided by the length itself two to four are not, and the others take 3 % longer.
    """
    longer = length / (settings.piece * settings.most_pieces)
    if longer <= LONG:
        return settings
    shares = {name: getattr(settings, name) / longer**2 for name in ("worth", "settled", "little")}
    return dataclasses.replace(settings, most_pieces=math.ceil(longer * settings.most_pieces), **shares)


def for_guide_planes(settings: OptimizationSettings) -> OptimizationSettings:
    """Return settings for a motion of up to `MANY` coordinates that crosses guide planes among obstacles at rest.

    By 17 of the thesis' scenes, chains of up to six links. The Hessian of a crossing holds a motion that goes through
    its plane by a rest, so that each evaluation moves it by next to nothing: with 2e-3 instead of 1e-3 some take 9 %
    longer, with 5e-4 some keep a tenth less. With a floor of 45 mm these motions keep up to 31 % less, with 70 mm one
    takes 12 % longer. With 64 pieces they keep 2 % more, take 0.7 % longer, and each evaluation and step takes twice
    the time.
    """
    return dataclasses.replace(_kept_from(settings, 0.065), few=True, worth=0.2, most_pieces=32, crossing=1e-3)


def for_guide_planes_of_many(settings: OptimizationSettings) -> OptimizationSettings:
    """The same for one of more coordinates.

    By eight of the thesis' scenes, chains of 10 to 48 links. What costs most are Newton's steps, so that these may be
    longer, though more evaluations find them too long: with 0.05, and 1e-2 as the first weight, there are a fifth more.
    With 0.15 one keeps 10 % less, with 1e-2 and 0.1 one isn't certified at first. With a worth of 0.1 they keep up to
    17 % less, with one of 0.02 as much. With a floor of 45 mm one in a tube keeps 31 % less, with 70 mm they keep 11 mm
    less in the mean and take 0.1 % less time, with 100 mm up to 4 % more. The crossings' Hessian holds them as it does
    others: less of it, and their steps, which move the tip far, are refused one after the other.
    """
    settings = _kept_from(of_many(settings), 0.085)
    return dataclasses.replace(settings, coarse=settings.coarse[1:], few=True, longest=0.1, worth=0.04)


def _kept_from(settings: OptimizationSettings, floor: float) -> OptimizationSettings:
    floor = max(settings.floor, floor)
    return dataclasses.replace(settings, floor=floor, farthest_floor=max(settings.farthest_floor, floor))


def closer(settings: OptimizationSettings) -> OptimizationSettings:
    """For a motion that the certificate refused: more weight on the clearance, and more samples. Unrecorded."""
    samples, fine = 2 * settings.samples, 2 * settings.fine_samples
    return dataclasses.replace(settings, weight=4.0 * settings.weight, samples=samples, fine_samples=fine)


def for_path_constraints(settings: OptimizationSettings) -> OptimizationSettings:
    """Return settings for a motion that keeps path constraints.

    A large weight of the limits' barrier would lead it off them first. Steps along a constraint that bends are short,
    and many bring little. On 33 random problems among boxes, without these motions take 1 % longer, and
    their optimisation 1.3 times the time.
    """
    return dataclasses.replace(settings, coarse=settings.coarse[1:], little=3e-4, settled=1e-4, shorter=0.5)
