"""Refuse to answer where the certificate and the clearance of one reply contradict each other: then there is a bug.

Coal confirms the smallest distances where they are (`prove.certificate.confirm`). If a motion that is certified free
comes closer than it is certified to, or two judges contradict each other, the request fails as an internal failure, and
case_file.py writes the motion for the referee, to `failures` beside the cache.
"""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from guidefield.case_file import Motion, write
from guidefield.collision.clearance import Contact
from guidefield.collision.pairs import PairNames
from guidefield.collision.world import World
from guidefield.geometry import cache
from guidefield.messages.requests import AttachedObject, MotionRequest
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import Clearance
from guidefield.planner.task.problem import Conditions
from guidefield.prove.certificate import smallest_along
from guidefield.prove.closest import put_obstacle
from guidefield.prove.curve import Curve
from guidefield.prove.search import ContradictionError
from guidefield.prove.tables import ROUNDED
from guidefield.prove.verdict import with_coal_error
from guidefield.robot.model.joints import LocalRate

ACCURACY = 2.0 * ROUNDED
"""Largest error of a distance that was found, beside Coal's [m]: rounding of kernels.

Larger, more contradictions pass unseen, but no contact; smaller, true replies are refused as failures.
"""

_log = logging.getLogger(__name__)

_Answer = TypeVar("_Answer", bound=Callable[..., Any])


def keep_contradictions(answer: _Answer) -> _Answer:
    """Decorate a function that answers a request for a run: keep the motion of a ContradictionError as a file."""

    @functools.wraps(answer)
    def answer_or_keep(request: MotionRequest, *given: Any, run_id: str, **named: Any) -> Any:
        try:
            return answer(request, *given, run_id=run_id, **named)
        except ContradictionError as error:
            if error.motion is None:
                raise
            made = _make_motion(request, *error.motion)
            kept = _keep(run_id, lambda: [made])
            raise ContradictionError(f"{error}; {kept}") from error

    return cast(_Answer, answer_or_keep)


def declare(
    request: MotionRequest,
    conditions: Conditions,
    motion: Trajectory | SubmittedMotion,
    held: Sequence[AttachedObject] | None = None,
    *,
    touching: Sequence[tuple[str, str]] = (),
    outside_proof: str | None = None,
) -> Motion:
    """Make the referee's motion of one that is certified under conditions.

    Args:
        held: The held objects; None: those of the request.
        touching: Pairs that touch at the start and part, which aren't tested.
        outside_proof: Certified properties that no case or proof contains, in words; None: those of the conditions.
    """
    given = motion if isinstance(motion, SubmittedMotion) else SubmittedMotion.of(motion)
    return Motion(
        world=conditions.world,
        placement=request.robot_placement,
        held=request.attached_objects if held is None else held,
        times=given.times,
        positions=given.positions,
        velocities=given.velocities,
        accelerations=None if given.quintic is None else given.accelerations,
        steps=given.kind is CurveKind.STEPS,
        tolerance=given.tolerance,
        jerk_limits=conditions.jerk_limits,
        min_clearance=conditions.min_clearance,
        path_constraints=request.path_constraints if conditions.path_constraints else (),
        limited=conditions.group,
        touching=touching,
        outside_proof=conditions.outside_proof if outside_proof is None else outside_proof,
    )


def declare_parts(
    request: MotionRequest, parts: Sequence[tuple[Conditions, SubmittedMotion]], contacts: Sequence[Contact]
) -> list[Motion]:
    """Make the referee's motions of one that leaves contacts, from `judgement.Leaving.parts`."""
    touching = [one.pair for one in contacts]
    return [declare(request, *part, touching=() if k else touching) for k, part in enumerate(parts)]


def _make_motion(request: MotionRequest, world: World, curve: Curve, min_clearance: float) -> Motion:
    """Make the referee's motion of a given curve, without limits of rates; of steps the middles, joined straight."""
    pieces, times, rates = curve.pieces, curve.times, list[np.ndarray]()
    endless = cast(LocalRate, np.full(world.group.nv, np.inf))
    ends: np.ndarray = np.concatenate([pieces, pieces[-1:, ::-1]])  # the last piece backwards: its end is a knot, too
    spans = np.append(np.diff(times), -np.diff(times)[-1])[:, None]
    order, jumps = pieces.shape[1] - 1, curve.jumps
    for power in range(1, 1 if jumps else (order + 1) // 2):
        rise = np.diff(ends, power, axis=1)[:, 0] / spans**power
        rates.append(math.perm(order, power) * rise)
    velocities, accelerations = [*rates, None, None][:2]
    return Motion(
        world=world,
        placement=request.robot_placement,
        held=request.attached_objects,
        times=times,
        positions=ends[:, 0],
        velocities=velocities,
        accelerations=accelerations,
        tolerance=None if curve.tube is None else curve.tube.max(axis=0),
        min_clearance=min_clearance,
        limited=replace(world.group, velocity_limits=endless, acceleration_limits=endless),
    )


class Certified(NamedTuple):
    """A motion that is certified free, and how far it keeps from everything."""

    measured: Clearance  # its smallest distances
    min_clearance: float  # what it is certified to keep from obstacles [m]
    motions: Callable[[], Sequence[Motion]]  # makes the motions that the referee reads
    since: float | None = None  # from when it is certified, on the clock of what was measured [s]; None: all along


def require_agreement(run_id: str, certified: Sequence[Certified]) -> None:
    """Refuse to answer where a clearance contradicts a certificate; the motion is kept as a file.

    Raises ContradictionError if a motion that is certified comes closer than it is certified to.
    """
    for one in certified:
        said = _describe_contradiction(one)
        if said is not None:
            raise ContradictionError(
                f"the certificate says that the motion is free, but {said}; {_keep(run_id, one.motions)}"
            )


def _describe_contradiction(one: Certified) -> str | None:
    obstacle, own, world = one.measured.obstacle, one.measured.own, one.measured.world
    if one.since is None:
        closest = [(obstacle.distance, obstacle.pair, obstacle.time, one.min_clearance)]
        closest.append((own.distance, own.pair, own.time, 0.0))
    else:  # before that a contact at the start is left
        times = np.unique(np.append(one.measured.times, one.since))
        span = one.since, float(times[-1])
        found = smallest_along(world, one.measured.curve, times, [(float(times[0]), span[1]), span]).obstacle[1]
        pair = None if found.pair < 0 else world.pair_names(found.pair)
        closest = [(found.distance, pair, found.time, one.min_clearance)]
    for distance, names, time, kept in closest:
        off = ACCURACY + float(with_coal_error(kept)) - kept
        if names is not None and (distance < kept - off or (distance == 0.0 and _touches(one.measured, names, time))):
            return f"{names[0]} and {names[1]} keep {1000 * distance:.6g} mm of {1000 * kept:.6g} mm at {time:.6g} s"
    return None


def _touches(measured: Clearance, names: PairNames, time: float) -> bool:
    """Return whether a pair touches at a time [s]: Coal tells a distance of 0 up to its accuracy."""
    world = measured.world
    pairs = [pair for pair in range(len(world.pairs)) if world.pair_names(pair) == names]
    world.place(world.group.expand_from_local(measured.curve.at(np.array([time]))[0]))
    for pair in pairs:
        put_obstacle(world, pair, time)
    return any(map(world.touches, pairs))


def _keep(run_id: str, motions: Callable[[], Sequence[Motion]]) -> str:
    file = cache.folder().with_name("failures") / f"{run_id}.json.xz"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file, *motions())
    except Exception:  # whatever it is, the contradiction is reported
        _log.exception("the motion that contradicts its certificate could not be kept")
        return "it could not be kept"
    _log.error("two judges contradict each other about a motion: %s", file)
    return f"the motion is kept as {file.name!r} in the folder `failures` of the cache: please report it"
