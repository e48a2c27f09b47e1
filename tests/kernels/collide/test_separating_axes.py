"""Axes away from primitives, against Coal: how far these reach along them; they separate by all of the distance."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numba import njit

from guidefield.kernels.collide.parts import PART, POLYTOPE, Parts
from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, HALF_SPACE, away_from_primitive
from guidefield.kernels.collide.separating_axes import kept_beyond
from guidefield.kernels.kinematics.poses import POSE
from guidefield.kernels.simd.packing import BLOCK, pointers
from guidefield.kernels.simd.vector import ALL_LANES, load, store


@njit
def _away(kind, row, points, out):
    row, points, out = pointers(row), pointers(points), pointers(out)
    x, y, z = load(points, 0), load(points, 16), load(points, 32)
    u, v, w, reach = away_from_primitive(kind, row, 0, x, y, z)
    store(out, 0, u)
    store(out, 16, v)
    store(out, 32, w)
    store(out, 48, reach)


@njit
def _left(parts, poses, axes, margin):
    parts, poses, axes = pointers(parts), pointers(poses), pointers(axes)
    u, v, w, reach = load(axes, 0), load(axes, 16), load(axes, 32), load(axes, 48)
    return kept_beyond(parts, 0, poses, 0, u, v, w, reach, margin)


def shape_of(kind: int, half: np.ndarray, radius: float) -> coal.ShapeBase:
    """The primitive as Coal has it."""
    if kind == BOX:
        return coal.Box(*2.0 * half)
    if kind == CYLINDER:
        return coal.Cylinder(radius, 2.0 * half[2])
    if kind == CAPSULE:
        return coal.Capsule(radius, 2.0 * half[2])
    return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)


def highest(shape: coal.ShapeBase, pose: pin.SE3, normal: np.ndarray) -> float:
    """How far a shape reaches along a normal: where a half-space against it touches it, by Coal's distance."""
    plane = coal.Halfspace(-normal, -10.0)  # points with n.x >= 10
    placed = coal.Transform3s(pose.rotation, pose.translation)
    return 10.0 - coal.distance(shape, placed, plane, coal.Transform3s(), coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize("kind", [BOX, CYLINDER, CAPSULE, HALF_SPACE])
@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 10_000))
def test_an_axis_separates_by_the_distance(kind: int, seed: int) -> None:
    """Points outside are beyond what the primitive reaches by their distance, those inside not at all."""
    rng = np.random.default_rng(seed)
    half, radius = rng.uniform(0.05, 0.5, 3), float(rng.uniform(0.05, 0.4))
    pose = pin.SE3(pin.Quaternion(rng.normal(size=4)).normalized().matrix(), rng.uniform(-0.5, 0.5, 3))
    row = np.array([*pose.rotation.T.ravel(), *pose.translation, *half, radius], np.float32)
    points = rng.uniform(-1.5, 1.5, (3, 16)).astype(np.float32)
    out = np.empty(64, np.float32)
    _away(kind, row, points.ravel(), out)
    axes, reach = out.reshape(4, 16)[:3].astype(float), out[48:].astype(float)
    shape = shape_of(kind, half, radius)
    for k in range(16):
        length = np.linalg.norm(axes[:, k])
        apart = coal.distance(
            shape,
            coal.Transform3s(pose.rotation, pose.translation),
            coal.Sphere(1e-9),
            coal.Transform3s(np.eye(3), points[:, k].astype(float)),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        beyond = axes[:, k] @ points[:, k] - reach[k]
        assert beyond <= (apart + 2e-6) * length + 1e-12  # never more than they are apart
        if apart > 1e-5:
            assert beyond / length == pytest.approx(apart, abs=2e-6)
        if length > 1e-5 and kind != HALF_SPACE:
            assert reach[k] / length == pytest.approx(highest(shape, pose, axes[:, k] / length), abs=2e-6)


@pytest.mark.parametrize("kind", [CYLINDER, CAPSULE])
def test_long_ones_reach_no_farther_than_is_said_where_points_are_close(kind: int) -> None:
    """What is off along an axis of 10 m for rounding is many times a hull's distance from it."""
    rng = np.random.default_rng(3)
    half, radius = np.array([0.0, 0.0, 5.0]), 0.02
    for _ in range(20):
        turn, local = pin.Quaternion(rng.normal(size=4)).normalized().matrix(), rng.uniform(-0.1, 0.1, (3, 16))
        local[2] *= 51.0
        pose = pin.SE3(turn, rng.uniform(-0.5, 0.5, 3))
        row = np.array([*turn.T.ravel(), *pose.translation, *half, radius], np.float32)
        points, out = (turn @ local + pose.translation[:, None]).astype(np.float32), np.empty(64, np.float32)
        _away(kind, row, points.ravel(), out)
        axes, reach = out.reshape(4, 16)[:3].astype(float), out[48:].astype(float)
        lengths = np.linalg.norm(axes, axis=0)
        for k in np.flatnonzero((axes * points).sum(axis=0) > reach + 0.02 * lengths):
            said = reach[k] / lengths[k]
            assert said == pytest.approx(highest(shape_of(kind, half, radius), pose, axes[:, k] / lengths[k]), abs=3e-6)


def test_a_polytope_is_beyond_where_all_its_corners_are_and_never_along_no_axis() -> None:
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(16, 3)).astype(np.float32)
    parts = Parts(
        np.zeros(4), np.array([-1, -1, 0]), np.array([POLYTOPE, 0, 1]), np.zeros(PART), corners.T.ravel().copy()
    )
    assert len(parts.vertices) == BLOCK
    turns = [pin.Quaternion(rng.normal(size=4)).normalized().matrix() for _ in range(16)]
    placements = np.array([np.c_[turn, rng.normal(size=3)] for turn in turns])
    poses = np.ascontiguousarray(placements.reshape(16, 12).T, np.float32).ravel()
    assert len(poses) == POSE
    normals = rng.normal(size=(16, 3))
    lowest = np.array([(n @ (p[:, :3] @ corners.T + p[:, 3:])).min() for n, p in zip(normals, placements, strict=True)])
    margin, off = 0.01, np.where(np.arange(16) % 2, 1e-4, -1e-4)
    reach = lowest - (margin + off) * np.linalg.norm(normals, axis=1)
    axes = np.concatenate([normals.T.ravel(), reach]).astype(np.float32)
    assert _left(parts, poses, axes, margin) == sum(1 << k for k in range(0, 16, 2))
    assert _left(parts, poses, np.zeros(64, np.float32), margin) == ALL_LANES
