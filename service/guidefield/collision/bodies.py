"""Balls about the robot's bodies, and its reach; which joints move what, and bounds on how much closer bodies come.

Filters of pairs and every certificate of a motion rest on balls and bounds (prove/, the planner, streams): they may be
larger, never smaller, and a change needs a proof like that of `MotionBound`. Scenes are cropped to the ball of
`reach_ball` (`scene/crop.py`), which may be larger, too. The referee bounds motions by code of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
from numpy.lib.stride_tricks import as_strided

from guidefield.kernels.collide.near_pairs import BodyBalls
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import ROTATION, TRANSLATION, JointKind
from guidefield.scene.crop import Ball

PARTS = 8
"""Number of boxes that a robot body's box is halved into: balls about them follow a long body closer than one ball.

A power of 2, and of the filter of near pairs alone (kernels/collide/near_pairs.py): it is a matter of time.
"""

SLIDE_MARGIN = 0.05  # sliding joints may be so far beyond their limits [m]: farther than any start or goal

# kinds of joints that leave the origin of their frame where it is
_TURNING_KINDS = {JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.SPHERICAL}


def joint_placements(data: Any, *, writeable: bool = False) -> np.ndarray:
    """Return a view of the placements of all joints in the world in Pinocchio's data, shape (njoints, 3, 4).

    A view, because copying them one by one takes longer than to compute them: it changes as Pinocchio places joints,
    and is valid as long as the data live. Raises RuntimeError if placements don't lie one behind the other in memory,
    as they do in Pinocchio 3 and 4.
    """
    return _one_behind_the_other(data.oMi, writeable=writeable)


def body_placements(data: Any) -> np.ndarray:
    """Return a writeable view of the placements of all bodies in Pinocchio's geometry data, shape (r, 3, 4) [m]."""
    return _one_behind_the_other(data.oMg, writeable=True)


def _one_behind_the_other(placements: Any, *, writeable: bool = False) -> np.ndarray:
    if not len(placements):
        return np.empty((0, 3, 4))
    size, count, first = np.dtype(float).itemsize, len(placements), placements[0].rotation
    begin = _address(first)
    ends = (placements[0].translation, placements[count - 1].rotation)
    # in a C++ vector all are as far apart as the first and the last say
    expected = [begin + 9 * size, begin + 12 * size * (count - 1)]
    if first.strides != (size, 3 * size) or list(map(_address, ends)) != expected:
        raise RuntimeError("Pinocchio's placements don't lie one behind the other")
    return as_strided(first, (count, 3, 4), (12 * size, size, 3 * size), writeable=writeable)


def _address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


@dataclass(frozen=True, eq=False)
class Bodies:
    """Facts about the robot's bodies that no configuration changes, in the order of the group's geometry.

    Columns j are those of the velocity of the group's `model`, mimic joints included.
    """

    joints: np.ndarray  # joint that carries each robot body, shape (r,); 0 is the world
    centres: np.ndarray  # balls about robot bodies, in the frame of that joint, shapes (r, 3) and (r,) [m]
    radii: np.ndarray
    part_centres: np.ndarray  # balls that together hold each, shapes (r, `PARTS`, 3) and (r,), in the same frame [m]
    part_radii: np.ndarray
    moved_by: np.ndarray  # whether joint j moves a robot body, shape (r, nv)
    turns: np.ndarray  # whether joint j turns (revolute, continuous) rather than slides, shape (nv,)

    @cached_property
    def balls(self) -> BodyBalls:
        """The balls as kernels read them."""
        return BodyBalls(self.joints, self.centres, self.radii, self.part_centres, self.part_radii)

    def centres_in_world(self, joint_placements: np.ndarray) -> np.ndarray:
        """Return the balls' centres (..., r, 3) [m, world], where all joints are placed by (..., njoints, 3, 4)."""
        frames = joint_placements[..., self.joints, :, :]
        centres: np.ndarray = (frames[..., :3] @ self.centres[:, :, None])[..., 0] + frames[..., 3]
        return centres


@memoized_for_alike
def bodies(group: PlanningGroup) -> Bodies:
    """Measure the bodies of a robot, once."""
    model, shapes = group.model, list(group.geometry.geometryObjects)
    balls = [bounding_ball(shape.geometry) for shape in shapes]
    parts = [parts_of(shape.geometry) for shape in shapes]
    joints = np.array([shape.parentJoint for shape in shapes], np.int64)
    moved_by = np.zeros((len(shapes), model.nv), bool)
    turns = np.zeros(model.nv, bool)
    for index in range(1, model.njoints):
        columns = slice(model.joints[index].idx_v, model.joints[index].idx_v + model.joints[index].nv)
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        turns[columns] = True
        if joint.kind in TRANSLATION:
            turns[columns][TRANSLATION[joint.kind]] = False
        moved_by[:, columns] = np.array([index in model.supports[parent] for parent in joints.tolist()])[:, None]
    arrays = {
        "joints": joints,
        "centres": np.array(
            [shape.placement.act(ball[0]) for shape, ball in zip(shapes, balls, strict=True)], float
        ).reshape(-1, 3),
        "radii": np.array([radius for _, radius in balls], float),
        "part_centres": np.array(
            [
                part[0] @ shape.placement.rotation.T + shape.placement.translation
                for shape, part in zip(shapes, parts, strict=True)
            ]
        ).reshape(-1, PARTS, 3),
        "part_radii": np.array([radius for _, radius in parts], float),
        "moved_by": moved_by,
        "turns": turns,
    }
    read_only(*arrays.values())
    return Bodies(**arrays)


BALLS: dict[type, Callable[[Any], float]] = {
    coal.Sphere: lambda shape: shape.radius,
    coal.Capsule: lambda shape: shape.halfLength + shape.radius,
    coal.Cylinder: lambda shape: float(np.hypot(shape.halfLength, shape.radius)),
    coal.Box: lambda shape: float(np.linalg.norm(shape.halfSide)),
    coal.Ellipsoid: lambda shape: float(max(shape.radii)),
}
"""Radius of the smallest ball about a primitive's own centre."""


def bounding_ball(shape: Any) -> tuple[np.ndarray, float]:
    """Return a ball that contains a bounded Coal shape: centre (3,) in the shape's frame, and radius [m]."""
    inflation = shape.getSweptSphereRadius() if hasattr(shape, "getSweptSphereRadius") else 0.0
    if type(shape) in BALLS:
        return np.zeros(3), BALLS[type(shape)](shape) + inflation
    shape.computeLocalAABB()
    centre = np.array(shape.aabb_center)
    if isinstance(shape, coal.BVHModelBase):
        return centre, float(np.linalg.norm(np.array(shape.vertices()) - centre, axis=1).max()) + inflation
    if isinstance(shape, coal.Convex):
        return centre, float(np.linalg.norm(np.array(shape.points()) - centre, axis=1).max()) + inflation
    return centre, float(shape.aabb_radius) + inflation


def parts_of(shape: Any) -> tuple[np.ndarray, float]:
    """Return balls that together contain a Coal shape: their centres (`PARTS`, 3) in its frame, and one radius [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    counts = np.ones(3, int)
    while counts.prod() < PARTS:
        counts[np.argmax((high - low) / counts)] *= 2
    cell = (high - low) / counts
    places = np.indices(tuple(counts.tolist())).reshape(3, -1).T
    return low + (places + 0.5) * cell, 0.5 * float(np.linalg.norm(cell))


@memoized_for_alike
def reach_ball(group: PlanningGroup, limited: bool = True) -> Ball | None:
    """Return the ball about all bodies of a group, within joint limits or not; None if a joint may go anywhere.

    Its centre is the first joint, or the mean of several. The distance from one joint to the next is at most that of
    its placement and of its slide.
    """
    model, about = group.model, bodies(group)
    first = [index for index in range(1, model.njoints) if model.parents[index] == 0]
    if not first:
        return None
    centre = np.mean([model.jointPlacements[index].translation for index in first], axis=0)
    slides = _slides(group, limited)
    if not np.isfinite(slides).all():
        return None
    away = np.zeros(model.njoints)
    for index in range(1, model.njoints):
        parent, there = model.parents[index], model.jointPlacements[index].translation
        apart = np.linalg.norm(there - centre) if parent == 0 else away[parent] + np.linalg.norm(there)
        away[index] = apart + slides[index]
    middle = np.where(about.joints[:, None] == 0, about.centres - centre, about.centres)
    reach = away[about.joints] + np.linalg.norm(middle, axis=1) + about.radii
    x, y, z = centre.tolist()
    return Ball(x, y, z, float(reach.max(initial=0.0)))


def _slides(group: PlanningGroup, limited: bool) -> np.ndarray:
    """Return the largest slide of each joint of the model, shape (njoints,) [m]; it may be infinite."""
    model, found = group.model, np.zeros(group.model.njoints)
    most, share = np.maximum(np.abs(group.lower), np.abs(group.upper)), np.abs(group.expand_velocity)
    each = np.multiply(share, most, out=np.zeros_like(share), where=share > 0.0)
    farthest = each.sum(axis=1) + np.abs(group.expand_offset)
    for index in range(1, model.njoints):
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        if joint.kind not in _TURNING_KINDS:
            within = limited and joint.kind is JointKind.PRISMATIC
            found[index] = farthest[model.joints[index].idx_v] + SLIDE_MARGIN if within else np.inf
    return found


@dataclass(frozen=True, eq=False)
class MotionBound(ReadOnly):
    """The certificate's motion bound, with everything in it that no configuration changes.

    For every configuration q with |q_j - m_j| <= e_j, a point of body b is at most

        sum over joints j that move b of  2 sin(e_j / 2) rho_bj        (a sliding joint: e_j)

    from where it is at m; rho_bj is the largest distance of b from axis j *at m*. Proof: turn the joints one after the
    other from base to tip; while j turns, all joints beyond it still stand at m, so that b is as far from axis j as at
    m. A ball joint turns by at most the Euclidean norm e of its coordinates' half widths (`to_local`), about an axis
    through its centre that may be any: rho is the largest distance from the centre. Lengths that belong together count
    by their norm. Of two moving bodies only joints that move one and not the other count: the others move both as one.
    A mimic joint's e is its source joint's times the size of its multiplier.
    """

    # matrix (nv of the model, group.nv) from half widths of planned joints to those of all that move
    half_widths: np.ndarray
    alone: np.ndarray  # whether a joint's move is its own column's, shape (nv of the model,)
    together: np.ndarray  # matrix (nv, nv of the model): which columns make one move, counted in its first column
    # the same for turns about a centre, halved: the squared distances from three axes through a point add up to twice
    # that from the point
    centred: np.ndarray
    turns: np.ndarray
    # 2 for the first column of a ball joint's rotation, 1 for joints that turn, 0 for those that slide
    doubled: np.ndarray
    radii: np.ndarray  # radius of the ball about a robot body, 0 where the joint slides, shape (r, nv of the model) [m]
    moved_by: np.ndarray
    own: np.ndarray
    first_only: np.ndarray  # joints that move the one body of own pairs and not the other, shape (n_self, nv)
    second_only: np.ndarray
    # the first column behind all joints that move both, shape (n_self,); none from there on moves both
    apart_from: np.ndarray

    def at(self, jacobians: np.ndarray, centres: np.ndarray, half_widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bound how much closer bodies can come: own pairs (s, n_self), and each to what stands still (s, r) [m].

        Of boxes of local coordinates with half widths (s, nv) about configurations with joint Jacobians in the world
        frame, shape (s, 6, nv of the model), and centres of the balls about the robot's bodies, shape (s, r, 3) [m,
        world].
        """
        return self.bound_moves(self.reach(jacobians, centres), half_widths)

    def bound_moves(self, reach: np.ndarray, half_widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bound as `at` does, by the result of `reach`."""
        moved = reach * self.sweep(half_widths)[:, None]
        beyond = np.zeros((*moved.shape[:2], moved.shape[2] + 1))  # what the joints from one on move a body
        beyond[..., :-1] = np.cumsum(moved[..., ::-1], axis=2)[..., ::-1]
        own = beyond[:, self.own[:, 0], self.apart_from] + beyond[:, self.own[:, 1], self.apart_from]
        return own, beyond[..., 0]

    def find_spread(self, half_widths: np.ndarray) -> np.ndarray:
        """Return half widths, or rates, of joints' moves, (s, nv of the model), of those of a point, (s, nv)."""
        spread: np.ndarray = np.sqrt((half_widths @ self.half_widths.T) ** 2 @ self.together)
        return spread

    def sweep(self, half_widths: np.ndarray) -> np.ndarray:
        """Bound how far each joint moves a point at a distance of 1, (s, nv of the model); given as `find_spread`."""
        spread = self.find_spread(half_widths)
        return np.where(self.turns, 2.0 * np.sin(0.5 * np.minimum(spread, np.pi)), spread)

    def reach(self, jacobians: np.ndarray, centres: np.ndarray) -> np.ndarray:
        """Bound the distance of each body from each axis that moves it, shape (s, r, nv of the model) [m].

        It is 1 for a joint that slides, and 0 for one that does not move the body; arguments as in `at`.
        """
        reach: np.ndarray = self.axis_distances(jacobians, centres) * self.moved_by
        return reach

    def axis_distances(self, jacobians: np.ndarray, centres: np.ndarray) -> np.ndarray:
        """Bound the distance of each body from every axis, whether that moves it or not; shape and units as `reach`."""
        # |v + w x c|^2 about the middle of the robot, where rounding is least
        middle = centres.mean(axis=1, keepdims=True)
        w = jacobians[:, None, 3:]
        v = jacobians[:, None, :3] + cross(jacobians[:, 3:], middle.swapaxes(1, 2))[:, None]
        c = (centres - middle)[..., None]
        rates = [
            v[:, :, i] + w[:, :, j] * c[:, :, k] - w[:, :, k] * c[:, :, j]
            for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        ]
        squared = np.square(rates).sum(axis=0)
        distances: np.ndarray = np.sqrt(squared @ self.centred) + self.radii
        return distances


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return cross products of columns, shapes (s, 3, n); NumPy's own takes five times as long."""
    columns = [a[:, i] * b[:, j] - a[:, j] * b[:, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.stack(columns, axis=1)


@memoized_for_alike
def motion_bound(group: PlanningGroup, own_pairs: bytes) -> MotionBound:
    """Build the bound of a robot for its own pairs of bodies, the bytes of an array (n_self, 2) of int64."""
    carried, own = bodies(group), np.frombuffer(own_pairs, np.int64).reshape(-1, 2)
    first, second = carried.moved_by[own[:, 0]], carried.moved_by[own[:, 1]]
    together, centred = _moves(group)
    arrays = {
        "half_widths": np.abs(group.expand_velocity),
        "alone": (together == np.eye(len(together))).all(axis=0) & (centred == together).all(axis=0),
        "together": together,
        "centred": centred,
        "turns": carried.turns.copy(),
        "doubled": _double(group, carried.turns),
        "radii": carried.radii[:, None] * carried.turns,
        "moved_by": carried.moved_by.copy(),
        "own": own.copy(),
        "first_only": first & ~second,
        "second_only": second & ~first,
        "apart_from": np.where(first & second, np.arange(1, first.shape[1] + 1), 0).max(axis=1, initial=0),
    }
    return MotionBound(**arrays)


def _moves(group: PlanningGroup) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices `together` and `centred` of `MotionBound`."""
    model = group.model
    together, centred = np.eye(model.nv), np.eye(model.nv)
    for index in range(1, model.njoints):
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        first = model.joints[index].idx_v
        for parts, is_turn in ((TRANSLATION, False), (ROTATION, True)):
            if joint.kind in parts:
                columns = np.arange(first, first + joint.nv)[parts[joint.kind]]
                together[columns, columns] = 0.0
                together[columns, columns[0]] = 1.0
                if is_turn:
                    centred[columns, columns] = 0.0
                    centred[columns, columns[0]] = 0.5
    return together, centred


def _double(group: PlanningGroup, turns: np.ndarray) -> np.ndarray:
    factors = turns.astype(float)
    for index in range(1, group.model.njoints):
        joint = group.robot.joint(group.model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        if joint.kind in ROTATION:
            factors[group.model.joints[index].idx_v + ROTATION[joint.kind].start] = 2.0
    return factors
