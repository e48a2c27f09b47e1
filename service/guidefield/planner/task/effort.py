"""Torques and forces that drive a robot along a motion, their largest values with bounds, and limits of them.

They are those of rigid bodies, of the group's joints, with what the robot holds, under the earth's gravity; without
friction and the inertia of rotors. The torque that a mimic joint takes is its source joint's.

Limits are checked by the bounds of `measure_efforts`. `BOUND_ACCURACY` is that of shares in replies and docs, and
refuses nothing; a larger `CLOSE_ACCURACY` refuses more that is just within, a smaller one no less without a smaller
`EXCESS` of kernels/timing/torques.py. Samples and margins choose how much a motion is slowed down before; where gravity
leaves less than `SAMPLE_MARGIN` of a limit it isn't, and may be refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.timing.carried_rates import BOUND, FOUND, TIME, MotionPolynomials
from guidefield.kernels.timing.torques import MassTree, largest_torques, torques_at
from guidefield.planner.task.motion_limits import KEPT_SHARE, CurveLimits, Reached, join_reached, parts_of
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import alike_group_joints, group_joints
from guidefield.robot.model.joints import JointKind, LocalPoints, LocalRate, LocalRates

GRAVITY = (0.0, 0.0, -9.81)  # [m/s², world]
BOUND_ACCURACY = 1e-2  # a bound of a torque is above the found value by at most this share of the limit
CLOSE_ACCURACY = 1e-4  # the same where the limit is between the two
PIECE_SAMPLES = 4  # samples of a piece by which a motion is slowed down to keep a limit
SAMPLE_MARGIN = 2e-3  # share of a limit that is left for torques between samples, and for the bound
ROUNDING = 1e-9  # share by which a factor of time may be above 1, and be left out
SLOWING = 1.002  # factor of a motion's time where its bound is above a limit, and no sample is
LEAST_SHARE = 1e-3  # share of a limit that is reserved for speeding up, though gravity takes more


@memoized_for_alike
def mass_tree(group: PlanningGroup) -> MassTree | str:
    """The bodies that a group's joints move, or why there is no dynamics, in words."""
    model = group.model
    if any(joint.kind in (JointKind.SPHERICAL, JointKind.FLOATING) for joint in group.joints):
        return "torques are known of joints of one coordinate, and planar ones"
    inertias = list(model.inertias)
    masses = np.array([one.mass for one in inertias])
    unmoved = [joint.name for joint in group.joints if not _moved_mass(group, masses, joint.name) > 0.0]
    if unmoved:
        return f"no link that {', '.join(unmoved)} move has a mass: the URDF has no <inertial> there"
    joints = alike_group_joints(group)
    table, n = joints.table, model.njoints
    rows = [_chain(table.parents, table.idx_v, table.nv, joint) for joint in range(n)]
    chains = np.full((n, max(1, *map(len, rows))), -1)
    for joint, row in enumerate(rows):
        chains[joint, : len(row)] = row
    angles = np.zeros(model.nv, np.int64)
    for joint in range(1, n):
        kind = model.joints[joint].shortname()
        first, count = model.joints[joint].idx_v, model.joints[joint].nv
        angles[first : first + count] = [0, 0, 1] if kind == "JointModelPlanar" else int("JointModelP" not in kind)
    matrices = np.array([one.inertia for one in inertias])
    # second moments of mass about the centre; those that no body has count by their magnitudes
    moments = 0.5 * np.trace(matrices, axis1=1, axis2=2)[:, None, None] * np.eye(3) - matrices
    spread = np.abs(np.linalg.eigvalsh(moments)).sum(axis=1)
    if ((masses <= 0.0) & (spread > 0.0))[1:].any():
        return "a link has an inertia, but no mass"
    tree = MassTree(
        joints,
        masses,
        np.array([one.lever for one in inertias]),
        np.ascontiguousarray(matrices),
        np.sqrt(spread / np.where(masses > 0.0, masses, 1.0)),
        chains,
        np.where(chains < 0, 0, angles[chains]),
        np.array(GRAVITY),
    )
    read_only(*tree[1:])
    return tree


def _moved_mass(group: PlanningGroup, masses: np.ndarray, name: str) -> float:
    """The mass that a joint moves [kg], its mimic joints' included."""
    joint = group.robot.joint(name)
    assert joint is not None, "a group's joints are the robot's"
    mimics = [one.name for one in group.robot.joints if one.mimic is not None and one.mimic.source == name]
    indices = [index for index in range(1, group.model.njoints) if group.model.names[index] in (name, *mimics)]
    return float(sum(masses[list(group.model.subtrees[index])].sum() for index in indices))


def _chain(parents: np.ndarray, first: np.ndarray, count: np.ndarray, joint: int) -> list[int]:
    """The model's coordinates that move a joint, from the root on."""
    rows: list[int] = []
    while joint > 0:
        rows = [*range(int(first[joint]), int(first[joint] + count[joint])), *rows]
        joint = int(parents[joint])
    return rows


def tree_of(group: PlanningGroup) -> MassTree | str:
    """`mass_tree` with the rotations at which this group's rotation vectors start."""
    tree = mass_tree(group)
    return tree if isinstance(tree, str) else tree._replace(joints=group_joints(group))


@memoized_for_alike
def stated_efforts(group: PlanningGroup) -> np.ndarray:
    """The robot's own limit of each coordinate's effort, shape (nv,) [N m or N]; infinite where it states none."""
    limits = np.full(group.nv, np.inf)
    for joint in group.joints:
        index = group.robot.model.joints[group.robot.model.getJointId(joint.name)]
        stated = np.array(group.robot.model.upperEffortLimit[index.idx_v : index.idx_v + index.nv])
        usable = np.isfinite(stated) & (stated > 0.0) & (stated < 1e300)  # 0 says that there is none
        limits[joint.idx_v : joint.idx_v + joint.nv] = np.where(usable, stated, np.inf)
    read_only(limits)
    return limits


def torques_of(tree: MassTree, zs: LocalPoints, rates: LocalRates, rises: LocalRates) -> np.ndarray:
    """Torques (g, nv) at points, velocities and accelerations of shape (g, nv) [N m or N]."""
    found = np.empty((len(zs), zs.shape[1]))
    points, first, second = (np.ascontiguousarray(one, float) for one in (zs, rates, rises))
    torques_at(tree, points, first, second, found)
    return found


def holding_torques(tree: MassTree, zs: LocalPoints) -> np.ndarray:
    """Torques (g, nv) that hold a robot still at points (g, nv) [N m or N]."""
    still = cast(LocalRates, np.zeros_like(zs))
    return torques_of(tree, zs, still, still)


@dataclass(frozen=True, eq=False)
class EffortLimit(ReadOnly):
    """The limits of a motion's torques."""

    tree: MassTree
    limits: LocalRate  # of each coordinate, shape (nv,); infinite where there is none [N m or N]
    names: tuple[str, ...]  # of the coordinates

    def scale(self, share: float) -> EffortLimit:
        """As in `MotionLimit`."""
        return replace(self, limits=cast(LocalRate, share * self.limits))

    @cached_property
    def limited(self) -> np.ndarray:
        """Indices of the coordinates that have a limit, shape (k,)."""
        return np.flatnonzero(np.isfinite(self.limits))

    def stretch(self, motion: MotionPolynomials) -> float:
        """As in `MotionLimit`; infinite where gravity alone takes more.

        In a time longer by a factor c torques are those of gravity plus the others by c².
        """
        if not len(motion.powers):
            return 0.0
        zs, rates, rises = sample(motion, PIECE_SAMPLES)
        held = holding_torques(self.tree, zs)[:, self.limited]
        others = torques_of(self.tree, zs, rates, rises)[:, self.limited] - held
        limits = (1.0 - SAMPLE_MARGIN) * self.limits[self.limited]
        with np.errstate(divide="ignore", invalid="ignore"):
            kept = (limits - np.sign(others) * held) / np.abs(others)
        least = float(np.min(np.where(others == 0.0, np.inf, kept)))
        if least <= 0.0 or (np.abs(held) > limits).any():
            return math.inf
        if least < 1.0 - ROUNDING:
            return 1.0 / math.sqrt(least)
        loose = np.full_like(self.limits, np.inf)
        reached, _ = _find_largest(self.tree, motion, loose, 0.5 * SAMPLE_MARGIN * self.limits, self.limits)
        fits = all(one.bound <= limit for one, limit in zip(reached, self.limits.tolist(), strict=True))
        return 0.0 if fits else SLOWING

    def along(self, points: LocalPoints, first: LocalRates, second: LocalRates) -> CurveLimits:
        """As in `MotionLimit`: of a limit there is what gravity leaves."""
        still, at = cast(LocalRates, np.zeros_like(first)), self.limited
        held = holding_torques(self.tree, points)
        on_u = torques_of(self.tree, points, still, first) - held
        on_x = torques_of(self.tree, points, first, second) - held
        limits, held = self.limits[at], held[:, at]
        below, above = (np.maximum(limits + side * held, LEAST_SHARE * limits) for side in (1.0, -1.0))
        return CurveLimits(np.full(len(points), np.inf), on_u[:, at], on_x[:, at], below, above)

    def faults(self, zs: LocalPoints) -> list[EffortFault | None]:
        """At each point (g, nv) the joint that gravity takes farthest beyond its limit; None where it can be held."""
        shares = holding_torques(self.tree, zs) / self.limits
        worst = np.argmax(np.abs(shares), axis=1)
        return [
            EffortFault(self.names[k], float(row[k] * self.limits[k]), float(self.limits[k]))
            if abs(row[k]) > KEPT_SHARE
            else None
            for row, k in zip(shares, worst.tolist(), strict=True)
        ]


@dataclass(frozen=True)
class EffortFault:
    """A joint whose torque exceeds its limit."""

    joint: str
    effort: float  # [N m or N]
    limit: float

    def describe(self, end: str) -> tuple[str, dict[str, object]]:
        """The refusal of an end of a motion, as a sentence and values."""
        message = (
            f"the {end} can't be held: joint {self.joint} needs {self.effort:.4g} N m against gravity there, its limit"
            f" is {self.limit:g} N m"
        )
        return message, {"stage": end, "joint": self.joint, "effort": self.effort, "limit": self.limit}


class EffortUse(NamedTuple):
    """The largest torque of a coordinate along a motion."""

    name: str
    reached: Reached  # [N m or N]; its bound counts where there is a limit
    limit: float  # infinite where there is none
    binds: bool  # whether the motion has to keep it

    @property
    def exceeds(self) -> bool:
        """True if a limit that binds isn't kept."""
        return self.binds and self.reached.bound > KEPT_SHARE * self.limit

    def describe_excess(self, place: str) -> tuple[str, dict[str, Any]]:
        """The excess as a sentence and values; `place` is where it is, in words."""
        reached = self.reached.bound
        message = f"joint {self.name} takes up to {reached:.6g} N m, its limit is {self.limit:g} N m, at {place}"
        details = {"stage": "limits", "limit": "effort", "joint": self.name, "value": reached, "most": self.limit}
        return message, {**details, "share": reached / self.limit}


@dataclass(frozen=True)
class Efforts:
    """The torques of a motion."""

    reason: str | None = None  # why there are none, in words
    uses: tuple[EffortUse, ...] = ()
    energy: float = 0.0  # [J]

    @property
    def excess(self) -> EffortUse | None:
        """The joint that exceeds its limit by the largest share; None if none does."""
        return max(
            (use for use in self.uses if use.exceeds), key=lambda use: use.reached.bound / use.limit, default=None
        )


def measure_efforts(
    group: PlanningGroup, limit: EffortLimit | None, motion: MotionPolynomials, deadline: Deadline = UNLIMITED
) -> Efforts:
    """The torques of a group along a motion, by its own limits, and by those that bind it instead.

    Raises DeadlineExpired if time is up before all of a long motion is examined.
    """
    tree = tree_of(group)
    if isinstance(tree, str):
        return Efforts(tree)
    binding = np.full(group.nv, np.inf) if limit is None else limit.limits
    limits = cast(LocalRate, np.where(np.isfinite(binding), binding, stated_efforts(group)))
    if not len(motion.powers):
        return Efforts("the motion goes nowhere")
    parts, works = list[list[Reached]](), list[float]()
    for part in parts_of(motion, deadline):
        found, work = largest_efforts(tree, part, limits, binding)
        parts.append(found)
        works.append(work)
    reached = [join_reached(each) for each in zip(*parts, strict=True)]
    rows = zip(group.velocity_names, reached, limits.tolist(), np.isfinite(binding).tolist(), strict=True)
    return Efforts(None, tuple(EffortUse(*row) for row in rows), sum(works))


def largest_efforts(
    tree: MassTree, motion: MotionPolynomials, limits: LocalRate, binding: np.ndarray | None = None
) -> tuple[list[Reached], float]:
    """The largest torque of each coordinate along a motion, and the work of all: taken or given back alike [J].

    Args:
        tree: The bodies.
        motion: With a piece at least.
        limits: Of each coordinate, shape (nv,), for `BOUND_ACCURACY`; where it is infinite there is no bound.
        binding: Limits that have to be kept: a bound beyond one has `CLOSE_ACCURACY`.
    """
    kept = np.full_like(limits, np.inf) if binding is None else binding
    return _find_largest(tree, motion, BOUND_ACCURACY * limits, CLOSE_ACCURACY * limits, kept)


def _find_largest(
    tree: MassTree, motion: MotionPolynomials, loose: np.ndarray, tight: np.ndarray, limits: np.ndarray
) -> tuple[list[Reached], float]:
    found = np.empty((len(limits), 3))
    work = largest_torques(tree, motion, loose, tight, limits, found)
    return [Reached(row[FOUND], row[BOUND], row[TIME]) for row in found.tolist()], work


def sample(motion: MotionPolynomials, count: int) -> tuple[LocalPoints, LocalRates, LocalRates]:
    """Points, velocities and accelerations at even places of each piece, its ends among them, each (n, nv)."""
    times = np.diff(motion.times)[:, None] * np.linspace(0.0, 1.0, count)
    powers, rows = motion.powers, []
    for order in range(3):
        factors = np.array([math.perm(power, order) for power in range(powers.shape[1])], float)
        exponents = np.maximum(np.arange(powers.shape[1]) - order, 0)
        rows.append(np.einsum("mtp,mpj->mtj", factors * times[..., None] ** exponents, powers))
    zs, rates, rises = (row.reshape(-1, powers.shape[2]) for row in rows)
    return cast(LocalPoints, zs), cast(LocalRates, rates), cast(LocalRates, rises)
