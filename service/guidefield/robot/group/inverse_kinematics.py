"""Inverse kinematics: configurations that bring a tip to a pose, far from each other, or why there are none.

Solutions are ends of damped descents (kernels) from starts that are given or drawn; the same random state gives the
same ones. `SearchSettings` trade how often a pose is missed against time; other values find other solutions, and tell
other causes and counts. `EXACT` is what a tolerance of 0 means to all who check poses (`planner/ends.py` proves by it).
"""

from __future__ import annotations

import dataclasses
import enum
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.surfaces import se3
from guidefield.kernels.kinematics import inverse_kinematics as kernels
from guidefield.kernels.kinematics.inverse_kinematics import Tolerances, distinct, farthest_apart
from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import ChainToTip, chain_to_tip, without_limits
from guidefield.robot.model.joints import WIND, LocalPoint, LocalPoints

EXACT = 1e-6  # a tolerance of zero, or any smaller than this, means this [m, rad]


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """A pose of the tip with tolerances along and about the target's own axes, (3,) each [m, rad]; inf if free.

    Those about the axes are components of the rotation vector from target to tip.
    """

    placement: Any
    position_tolerance: np.ndarray
    orientation_tolerance: np.ndarray

    @classmethod
    def from_wire(cls, pose: TargetPose | PoseGoal) -> PoseTarget:
        """Build the target of a message, in which null is a free axis."""
        tolerances = [
            np.array([np.inf if axis is None else axis for axis in axes])
            for axes in (pose.position_tolerance, pose.orientation_tolerance)
        ]
        read_only(*tolerances)
        return cls(se3(pose.position, pose.quaternion_xyzw), *tolerances)

    def is_reached(self, T_world_tip: Any) -> bool:
        """Return whether a placement of the tip (pinocchio.SE3) is within the tolerances."""
        offset = self.placement.actInv(T_world_tip)
        return bool(
            np.all(np.abs(offset.translation) <= np.maximum(self.position_tolerance, EXACT))
            and np.all(np.abs(pin.log3(offset.rotation)) <= np.maximum(self.orientation_tolerance, EXACT))
        )


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for configurations that reach a pose: more starts find more, and take longer."""

    # share of a tolerance within which a descent ends, so that an approach from outside ends inside. Unrecorded
    aim: float = 0.9
    round: int = 64  # random starts of a round. Unrecorded
    first_round: int = 16  # the same of the first rounds if one solution is requested. Unrecorded
    # the same where nothing was accepted that often: poses in narrow places need many starts. The value is unrecorded
    large_round: int = 512
    # accepted solutions for each requested one, from which those farthest apart are chosen. Unrecorded
    choice: int = 2
    # random starts after which a pose counts as unreachable. With it all of 1000 reachable poses of a Panda are solved
    most_unreached: int = 256
    most_rejected: int = 1024  # the same after which it counts as reachable only by what isn't accepted. Unrecorded
    most_per_solution: int = 64  # the same for each requested solution, if some are found. Unrecorded
    most_kept: int = 256  # distinct solutions that are kept of those not accepted: they explain a failure
    why_starts: int = 64  # random starts for each query that explains a failure. Unrecorded
    why_halvings: int = 8  # how often half a turn is halved to find the nearest orientation in reach: to 0.7 degrees


SEARCH = SearchSettings()


class PoseSearch:
    """Descents of one group to one target.

    Attributes:
        chain: The chain that moves the tip.
        base: A point (nv,) that gives coordinates that don't move the tip, and near which whole turns are chosen.
        closest: Excesses over the tolerances, translation and rotation vector, of the least error met, shape (6,).
    """

    def __init__(
        self, group: PlanningGroup, target: PoseTarget, base: LocalPoint, chain: ChainToTip | None = None
    ) -> None:
        self.chain = chain_to_tip(group) if chain is None else chain
        self.base = base
        self._group = group
        self._table = self.chain.from_target(target.placement)
        tolerances = np.concatenate([target.position_tolerance, target.orientation_tolerance])
        allowed = np.where(tolerances > EXACT, tolerances, 0.5 * EXACT)  # half: others may check in another way
        self._tolerances = Tolerances(
            _freeze(allowed),
            _freeze(np.where(tolerances > EXACT, SEARCH.aim * tolerances, 0.0)),
            group.size,
            group.sizes,
        )
        self._closest = np.full(7, np.inf)

    @property
    def closest(self) -> np.ndarray:
        """See the class: shape (6,)."""
        return self._closest[1:]

    def draw(self, count: int, rng: np.random.Generator) -> LocalPoints:
        """Draw local coordinates (count, nv), those nearest to the target first.

        What has no limits is within pi of 0, or within `WIND` of the base where it is an angle whose whole turns count.
        """
        lower, upper = self._table.lower, self._table.upper
        lower, upper = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
        lower = np.where(self._group.winds, self.base - WIND, lower)
        upper = np.where(self._group.winds, self.base + WIND, upper)
        points: LocalPoints = rng.uniform(lower, upper, (count, len(lower)))
        points[:, ~self.chain.moving] = self.base[~self.chain.moving]
        squared = np.empty(count)
        kernels.squared_errors(self._table, self._tolerances, points, squared)
        return points[np.argsort(squared, kind="stable")]

    def descend(self, starts: LocalPoints) -> LocalPoints:
        """Descend from starts (n, nv); return those ends (k, nv) within tolerances and limits, in the starts' order."""
        starts = np.ascontiguousarray(starts, float)
        ends, reached = np.empty_like(starts), np.zeros(len(starts), np.bool_)
        kernels.descend(self._table, self._tolerances, starts, ends, reached, self._closest)
        return ends[reached]

    def near_base(self, points: LocalPoints) -> LocalPoints:
        """Return the same configurations (n, nv), moved by whole turns as near to the base as the limits let them."""
        turns = self.chain.turning
        if not len(turns):
            return points
        z, period = points[:, turns], self.chain.measure.periods[turns]
        least = np.ceil((self._table.lower[turns] - z) / period)
        most = np.floor((self._table.upper[turns] - z) / period)
        near = points.copy()
        near[:, turns] += period * np.minimum(np.maximum(np.rint((self.base[turns] - z) / period), least), most)
        return near

    def turned(self, z: LocalPoint) -> list[np.ndarray]:
        """Return, for each coordinate of a point (nv,), the values in its limits that mean the same configuration.

        One where there are no limits: all whole turns are the same configuration then.
        """
        values = [np.array([value]) for value in z]
        for j in self.chain.turning:
            low, high, period = self._table.lower[j], self._table.upper[j], self.chain.measure.periods[j]
            if np.isfinite(high - low):
                values[j] = z[j] + period * np.arange(np.ceil((low - z[j]) / period), (high - z[j]) // period + 1)
        return values


def _freeze(array: Any) -> np.ndarray:
    frozen = np.array(array, float)
    frozen.setflags(write=False)
    return frozen


class Cause(enum.Enum):
    """The reason why a pose isn't reached; the values are the words of replies."""

    OUT_OF_REACH = "out of reach"
    """The chain to the tip is too short; the one cause that is certain."""
    POSITION = "position"
    """The place can't be reached, whatever the orientation."""
    ORIENTATION = "orientation"
    """The place can be reached, but not with this orientation."""


@dataclass(frozen=True, eq=False)
class Unreached:
    """The cause why a pose is not reached, the same as a sentence, and the values in this."""

    cause: Cause
    reason: str
    values: dict[str, Any]

    @property
    def details(self) -> dict[str, Any]:
        """Cause and values, for a reply."""
        return {"cause": self.cause.value, **self.values}


def prove_out_of_reach(chain: ChainToTip, target: PoseTarget) -> Unreached | None:
    """Prove that a pose is farther away than the chain is long; None where it isn't."""
    begin = target.placement.actInv(chain.table.first[3::4])
    beyond = np.maximum(np.abs(begin) - target.position_tolerance, 0.0)
    short = math.sqrt(float(beyond @ beyond)) - chain.reach - EXACT
    if short <= 0.0:
        return None
    sentence = (
        f"out of reach: at least {int(1000.0 * short)} mm short, as the chain to the tip is {chain.reach:.3g} m long"
    )
    return Unreached(Cause.OUT_OF_REACH, sentence, {"short_by": short, "reach": chain.reach})


def why_unreached(
    group: PlanningGroup, target: PoseTarget, search: PoseSearch, tried: str, rng: np.random.Generator
) -> Unreached:
    """Find the cause why no descent reached a pose; by descents, so nothing of it is proved.

    Args:
        search: The search that failed.
        tried: How much was tried, for the sentence.
        rng: Where random starts come from.
    """
    place = dataclasses.replace(target, orientation_tolerance=np.full(3, np.inf))
    descent = PoseSearch(group, place, search.base)
    values: dict[str, Any]
    if not len(descent.descend(descent.draw(SEARCH.why_starts, rng))):
        off = float(np.linalg.norm(descent.closest[:3]))
        sentence = f"the tip gets no nearer to the place than {1000.0 * off:.3g} mm, in any orientation"
        cause, values = Cause.POSITION, {"position_off": off}
    elif np.isfinite(target.orientation_tolerance).any():
        off = _turn_needed(group, target, search.base, rng)
        sentence = (
            f"the place is in reach, but not in this orientation: the nearest is about {off:.2g} rad"
            f" ({np.degrees(off):.0f} degrees) off"
        )
        cause, values = Cause.ORIENTATION, {"orientation_off": off}
    else:
        position, rotation = (float(np.linalg.norm(part)) for part in (search.closest[:3], search.closest[3:]))
        sentence = f"the closest is {position:.2g} m and {rotation:.2g} rad off"
        cause, values = Cause.POSITION, {"position_off": position}
    beyond = _limit_in_the_way(group, target, search.base, rng)
    if beyond is not None:
        sentence += f"; without limits it is reached: {beyond[0]}"
        values.update(beyond[1])
    return Unreached(cause, f"no solution from {tried}: {sentence}", values)


def _turn_needed(group: PlanningGroup, target: PoseTarget, base: LocalPoint, rng: np.random.Generator) -> float:
    """Find how much more the tip must be allowed to turn about each axis until descents reach the place [rad]."""
    low, high = 0.0, np.pi
    for _ in range(SEARCH.why_halvings):
        middle = 0.5 * (low + high)
        allowed = dataclasses.replace(target, orientation_tolerance=target.orientation_tolerance + middle)
        descent = PoseSearch(group, allowed, base)
        if len(descent.descend(descent.draw(SEARCH.why_starts, rng))):
            high = middle
        else:
            low = middle
    return high


def _limit_in_the_way(
    group: PlanningGroup, target: PoseTarget, base: LocalPoint, rng: np.random.Generator
) -> tuple[str, dict[str, Any]] | None:
    """Find the limit in the way, in the solution for which limits have to give way least; a sentence, its values."""
    bounded = PoseSearch(group, target, base)
    free = PoseSearch(group, target, base, without_limits(bounded.chain))
    points = bounded.near_base(free.descend(bounded.draw(SEARCH.why_starts, rng)))
    if not len(points):
        return None
    excess = np.maximum(np.maximum(group.lower - points, points - group.upper), 0.0)
    z, excess = points[best := int(np.argmin(excess.max(axis=1)))], excess[best]
    worst = int(np.argmax(excess))
    if excess[worst] <= 0.0:
        return None
    joint = next(joint for joint in group.joints if joint.idx_v <= worst < joint.idx_v + joint.nv)
    limits = [float(group.lower[worst]), float(group.upper[worst])]
    sentence = f"{joint.name} would have to be at {z[worst]:.4g}, its limits are [{limits[0]:.4g}, {limits[1]:.4g}]"
    return sentence, {"joint": joint.name, "value": float(z[worst]), "limits": limits}


Accept = Callable[[LocalPoints], np.ndarray]
"""Tells which of some local coordinates, shape (n, nv), may be solutions: shape (n,), bool."""

Refine = Callable[[LocalPoints], LocalPoints]  # moves local coordinates, shape (n, nv), to others


@dataclass(frozen=True, eq=False)
class IkResult(ReadOnly):
    """The solutions of inverse kinematics."""

    # local coordinates (nv,) of distinct configurations in the limits and accepted; first those reached from the given
    # starts, in their order, then each as far as can be from those before
    solutions: tuple[LocalPoint, ...]
    reason: str  # why there are fewer than requested; else empty
    details: dict[str, Any] = field(default_factory=dict)  # the values in the reason
    rejected: tuple[LocalPoint, ...] = ()  # those found that were not accepted
    cause: Cause | None = None  # the obstacle if nothing was found, not even something that was not accepted
    # whether nothing was accepted, the last starts led to nothing new, and all that was found is in `rejected`: the
    # same search with another rule for what is accepted finds the same
    exhausted: bool = False

    @classmethod
    def unreached(cls, why: Unreached) -> IkResult:
        """Make the result that nothing was found, and why."""
        return cls((), why.reason, why.details, cause=why.cause)


def solve(
    group: PlanningGroup,
    target: PoseTarget,
    starts: Sequence[LocalPoint],
    count: int,
    *,
    rng: np.random.Generator,
    refine: Refine | None = None,
    accept: Accept | None = None,
    fault: str = "in collision",
    most: int = SEARCH.most_rejected,
    deadline: Deadline = UNLIMITED,
) -> IkResult:
    """Find distinct configurations of a group that bring its tip to a pose.

    Descents from the given starts and then from random ones, several at once, until there are enough to choose those
    that lie far from each other. Configurations that differ by whole turns alone count as one until there are no
    others. Joints that don't move the tip are as in the first start. Nothing is proved where nothing is found, except
    what is out of reach.

    Args:
        starts: Local coordinates to start from, each of shape (nv,).
        count: How many solutions to look for.
        rng: The same state gives the same solutions.
        refine: Moves configurations that reach the target, shape (n, nv), to better ones that do.
        accept: Decides which configurations may be a solution.
        fault: What is wrong with those that may not, for the reason.
        most: Random starts after which a pose counts as reachable only by what isn't accepted.
        deadline: Ends the search between rounds.
    """
    given = cast(LocalPoints, np.array(starts).reshape(-1, group.nv))
    base = given[0] if len(given) else group.to_local(group.part_of(group.q_reference))
    search = PoseSearch(group, target, base)
    if (short := prove_out_of_reach(search.chain, target)) is not None:
        return IkResult.unreached(short)
    found = _Solution(search, refine, accept)
    found.add(search.descend(given))
    from_starts = len(found.accepted)
    drawn = 0
    while not (_enough(found, count, drawn, most) or deadline.expired()):
        size = (
            SEARCH.first_round
            if count == 1 and drawn < SEARCH.round
            else SEARCH.large_round
            if drawn >= SEARCH.large_round
            else SEARCH.round
        )
        found.add(search.near_base(search.descend(search.draw(size, rng))))
        drawn += size
    tried = f"{len(starts) + drawn} starts"
    rejected = tuple(found.rejected)
    if not len(found.accepted) and not rejected:
        return IkResult.unreached(why_unreached(group, target, search, tried, rng))
    if not len(found.accepted):
        details = {"cause": fault, "solutions": len(rejected)}
        more = "at least " if len(rejected) == SEARCH.most_kept else ""
        reason = f"{more}{_solutions(len(rejected))} from {tried}, all {fault}"
        exhausted = not found.fresh and len(rejected) < SEARCH.most_kept
        return IkResult((), reason, details, rejected, exhausted=exhausted)
    chosen = _choose(search, found.accepted, from_starts, len(starts) > 0, count)
    solutions = tuple(chosen)
    if len(solutions) == count:
        return IkResult(solutions, "", rejected=rejected)
    others = f", {len(rejected)} more {'is' if len(rejected) == 1 else 'are'} {fault}" if rejected else ""
    return IkResult(solutions, f"{_solutions(len(solutions))} from {tried}{others}", rejected=rejected)


class _Solution:
    """Distinct solutions, accepted (n, nv) and at most `SEARCH.most_kept` rejected ones; `fresh` were added last."""

    def __init__(self, search: PoseSearch, refine: Refine | None, accept: Accept | None) -> None:
        self._measure, self._refine, self._accept = search.chain.measure, refine, accept
        self.accepted = self.rejected = cast(LocalPoints, np.empty((0, len(search.base))))
        self.fresh = 0

    def add(self, ends: LocalPoints) -> None:
        before = len(self.accepted) + len(self.rejected)
        if self._refine is not None:
            known = np.concatenate([self.accepted, self.rejected])
            ends = self._refine(cast(LocalPoints, self._with(known, ends)[len(known) :]))
        free = np.ones(len(ends), bool)
        if self._accept is not None and len(ends):
            free = self._accept(ends)
        self.accepted = self._with(self.accepted, ends[free])
        if len(self.rejected) < SEARCH.most_kept:
            self.rejected = self._with(self.rejected, ends[~free])[: SEARCH.most_kept]
        self.fresh = len(self.accepted) + len(self.rejected) - before

    def _with(self, known: LocalPoints, others: LocalPoints) -> LocalPoints:
        """Return distinct points (n, nv), and those of others (k, nv) that are like none before."""
        points = np.concatenate([known, others])
        kept = np.empty(len(points), np.int64)
        distinct_ones: LocalPoints = points[kept[: distinct(self._measure, points, len(known), kept)]]
        return distinct_ones


def _enough(found: _Solution, count: int, drawn: int, most: int) -> bool:
    accepted, rejected = len(found.accepted), len(found.rejected)
    if not accepted and not rejected:
        return drawn >= SEARCH.most_unreached
    if not accepted:
        return drawn >= most or (drawn >= SEARCH.most_unreached and not found.fresh and rejected < SEARCH.most_kept)
    if count == 1 or accepted >= SEARCH.choice * count or drawn >= SEARCH.most_per_solution * count:
        return True
    return drawn >= SEARCH.round and not found.fresh


def _choose(search: PoseSearch, points: LocalPoints, from_starts: int, nearest: bool, count: int) -> list[LocalPoint]:
    """Choose some of local coordinates (n, nv), far from each other; then others that differ from these by whole turns.

    The first `from_starts` are chosen anyway; without such the nearest to the base, if `nearest`.
    """
    if nearest and from_starts == 0:
        first = int(np.argmin(np.linalg.norm((points - search.base) / search.chain.measure.units, axis=1)))
        points = np.concatenate([points[first : first + 1], np.delete(points, first, axis=0)])
    order = np.empty(min(count, len(points)), np.int64)
    farthest_apart(search.chain.measure, points, max(from_starts, 1), order)
    chosen = list(points[order])
    for z in chosen.copy():
        if len(chosen) == count:
            break
        same = (np.array(values) for values in itertools.product(*search.turned(z)))
        others = (other for other in same if np.abs(other - z).max() > 1.0)
        chosen += itertools.islice(others, count - len(chosen))
    return chosen


def _solutions(count: int) -> str:
    return f"{count} distinct solution{'' if count == 1 else 's'}"
