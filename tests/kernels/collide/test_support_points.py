"""A support point is on the body, and no other point of the body is farther: in every kernel that has one.

Directions are parallel and orthogonal to a body's axes, a few units in the last place away from these, and random; any
length.
"""

from typing import Any, NamedTuple

import coal
import numba
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.part_tables import PartsTable
from guidefield.kernels.collide.gjk import WORK, reach_along, support
from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, away_from_primitive
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import load, store

SHARE = 1e-13  # what a point may be off a body, or short of the farthest one, of the body's size

SINGLE = 1e-6  # the same in kernels that know corners in single precision

KINDS = ("cylinder", "cylinder", "cylinder", "ball", "capsule", "box")


class Body(NamedTuple):
    """A body at the origin: what `half` and `radius` say of its kind [m], and how it is turned, shape (3, 3)."""

    kind: str
    half: np.ndarray
    radius: float
    rotation: np.ndarray

    @property
    def core(self) -> tuple[np.ndarray, float, float]:
        """Half extents (3,) of a box, a disc's radius about its last axis, and a ball's: the body is their sum [m]."""
        if self.kind == "box":
            return self.half, 0.0, 0.0
        along = np.array([0.0, 0.0, 0.0 if self.kind == "ball" else self.half[2]])
        return along, *((self.radius, 0.0) if self.kind == "cylinder" else (0.0, self.radius))

    @property
    def size(self) -> float:
        """The radius of a ball about it [m]."""
        half, disc, ball = self.core
        return float(np.linalg.norm(half)) + disc + ball

    @property
    def shape(self) -> Any:
        """Coal's shape."""
        if self.kind == "box":
            return coal.Box(*(2.0 * self.half))
        if self.kind == "ball":
            return coal.Sphere(self.radius)
        return {"cylinder": coal.Cylinder, "capsule": coal.Capsule}[self.kind](self.radius, 2.0 * self.half[2])

    def check(self, direction: np.ndarray, point: np.ndarray, rounded: bool, share: float) -> None:
        """Judge a support point (3,) of the body, or of what is inside its rounding, in the frame of the world [m]."""
        half, disc, ball = self.core
        ball = ball if rounded else 0.0
        local, along = self.rotation.T @ point, self.rotation.T @ (direction / np.abs(direction).max())
        along /= np.linalg.norm(along)
        off = share * self.size
        beyond = np.abs(local) - half
        if disc > 0.0:
            beyond[0] = np.hypot(local[0], local[1]) - disc
            beyond[1] = 0.0
        assert np.linalg.norm(np.maximum(beyond, 0.0)) <= ball + off, "the point is on the body"
        farthest = np.abs(along) @ half + disc * np.hypot(along[0], along[1]) + ball
        assert local @ along >= farthest - off, "no other point is farther"


@st.composite
def rotations(draw: st.DrawFn) -> np.ndarray:
    """Rotations (3, 3): none, by multiples of pi/2 as sums of angles have them, and any."""
    if draw(st.booleans()):
        angles = [draw(st.integers(-4, 4)) * (np.pi / 2.0) for _ in range(3)]
        return pin.rpy.rpyToMatrix(*angles)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return pin.rpy.rpyToMatrix(*rng.uniform(-4.0, 4.0, 3))


@st.composite
def bodies(draw: st.DrawFn) -> Body:
    sizes = [draw(st.sampled_from((1e-4, 0.02, 0.033, 0.5, 3.0))) for _ in range(4)]
    return Body(draw(st.sampled_from(KINDS)), np.array(sizes[:3]), sizes[3], draw(rotations()))


@st.composite
def directions(draw: st.DrawFn, body: Body, scales: st.SearchStrategy[float]) -> np.ndarray:
    """A direction (3,) of the world."""
    axes = body.rotation.T
    kind = draw(st.sampled_from(("along", "along", "along", "across", "diagonal", "any")))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    if kind == "along":
        direction = draw(st.sampled_from((-1.0, 1.0))) * axes[draw(st.sampled_from((2, 2, 2, 2, 0, 1)))]
    elif kind == "across":
        turn = rng.uniform(0.0, 2.0 * np.pi)
        direction = np.cos(turn) * axes[0] + np.sin(turn) * axes[1]
    else:
        direction = rng.normal(size=3) if kind == "any" else np.sign(rng.normal(size=3)) @ axes
    away = draw(st.sampled_from((0.0, 0.0, 0.0, 0.0, 1e-16, 1e-15, 1e-12, 1e-9)))
    direction = direction + away * rng.normal(size=3)
    for k in range(3):
        for _ in range(draw(st.integers(0, 3))):
            direction[k] = np.nextafter(direction[k], rng.choice([-np.inf, np.inf]))
    return direction / np.linalg.norm(direction) * draw(scales)


@numba.njit(error_model="numpy")
def _support(parts, pose, direction, work, out):
    parts, work = pointers(parts), pointers(work)
    for k in range(12):
        work[k] = pose[k]
    x, y, z = direction[0], direction[1], direction[2]
    out[0], out[1], out[2] = support(parts.shapes, parts.numbers, parts.vertices, 0, work, 0, x, y, z)


@numba.njit(error_model="numpy")
def _reach(parts, direction, work):
    parts, work = pointers(parts), pointers(work)
    return reach_along(parts, 0, work, direction[0], direction[1], direction[2])


@settings(max_examples=90)
@given(data=st.data(), body=bodies())
def test_gjk_finds_the_support_point(data: Any, body: Body) -> None:
    # corners are in single precision, which knows no other lengths; a search ends before a direction is that short
    far_out = () if body.kind == "box" else (1e-250, 1e150)
    direction = data.draw(directions(body, st.sampled_from((1.0, 1.0, 1e-9, 1e9, *far_out))))
    table, found = PartsTable(), np.empty(3)
    table.add_shape(body.shape, pin.SE3.Identity())
    _support(table.tables(), np.c_[body.rotation, np.zeros(3)].ravel(), direction, np.zeros(WORK), found)
    body.check(direction, found, False, SINGLE if body.kind == "box" else SHARE)


@settings(max_examples=60)
@given(data=st.data(), body=bodies())
def test_a_part_reaches_as_far_as_the_body(data: Any, body: Body) -> None:
    direction = data.draw(directions(body, st.just(1.0)))
    table = PartsTable()
    table.add_shape(body.shape, pin.SE3(body.rotation, np.zeros(3)))
    (half, disc, ball), along = body.core, body.rotation.T @ direction
    farthest = np.abs(along) @ half + disc * np.hypot(along[0], along[1]) + ball
    reach = _reach(table.tables(), direction, np.zeros(WORK))
    assert reach == pytest.approx(farthest, abs=(SINGLE if body.kind == "box" else SHARE) * body.size)


@numba.njit
def _away(kind, row, points, out):
    row, points, out = pointers(row), pointers(points), pointers(out)
    x, y, z = load(points, 0), load(points, 16), load(points, 32)
    for k, one in enumerate(away_from_primitive(kind, row, 0, x, y, z)):
        store(out, 16 * k, one)


@settings(max_examples=60)
@given(data=st.data(), body=bodies())
def test_in_batches_a_primitive_reaches_no_farther_along_an_axis_than_is_said(data: Any, body: Body) -> None:
    kind = {"box": BOX, "cylinder": CYLINDER}.get(body.kind, CAPSULE)
    half, disc, ball = body.core
    row = np.array([*body.rotation.T.ravel(), 0.0, 0.0, 0.0, *half, disc + ball], np.float32)
    scales = st.sampled_from((1.0, 1.0 + 1e-7, 1.5, 10.0))
    points = np.array([data.draw(directions(body, scales)) * body.size for _ in range(4)] * 4, np.float32).T
    out = np.empty(64, np.float32)
    _away(kind, row, np.ascontiguousarray(points).ravel(), out)
    axes, reach = out.reshape(4, 16)[:3].astype(float), out[48:].astype(float)
    rotation = row[:9].reshape(3, 3).astype(float)
    for k in range(16):
        along = rotation @ axes[:, k]
        farthest = np.abs(along) @ half + disc * np.hypot(along[0], along[1]) + ball * np.linalg.norm(axes[:, k])
        assert reach[k] >= farthest - 4.0 * SINGLE * np.linalg.norm(axes[:, k]) * body.size


@pytest.mark.parametrize("kind", [CYLINDER, CAPSULE])
def test_long_ones_reach_no_farther_than_is_said_where_points_are_close(kind: int) -> None:
    """What is off along an axis of 10 m for rounding is many times a hull's distance from it."""
    rng, half, radius = np.random.default_rng(3), 5.0, 0.02
    for _ in range(20):
        turn, local = pin.Quaternion(rng.normal(size=4)).normalized().matrix(), rng.uniform(-0.1, 0.1, (3, 16))
        local[2] *= 51.0
        middle = rng.uniform(-0.5, 0.5, 3)
        row = np.array([*turn.T.ravel(), *middle, 0.0, 0.0, half, radius], np.float32)
        points, out = (turn @ local + middle[:, None]).astype(np.float32), np.empty(64, np.float32)
        _away(kind, row, points.ravel(), out)
        axes, reach = out.reshape(4, 16)[:3].astype(float), out[48:].astype(float)
        lengths = np.linalg.norm(axes, axis=0)
        for k in np.flatnonzero((axes * points).sum(axis=0) > reach + 0.02 * lengths):
            along = turn.T @ axes[:, k] / lengths[k]
            disc = np.hypot(along[0], along[1]) if kind == CYLINDER else 1.0
            highest = axes[:, k] / lengths[k] @ middle + half * abs(along[2]) + radius * disc
            assert reach[k] / lengths[k] == pytest.approx(highest, abs=3e-6)
