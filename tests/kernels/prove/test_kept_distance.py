"""Bodies that turn and shift for a while: what the kernel says that they keep, against Coal at many of the times."""

import itertools
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from hypothesis import given, settings, strategies as st
from numba import types

from guidefield.collision.part_tables import PartsTable
from guidefield.kernels.collide.gjk import AXIS, WORK
from guidefield.kernels.collide.parts import PARTS, Parts
from guidefield.kernels.jit.arrays import VECTOR, VECTOR_OUT, Floats
from guidefield.kernels.jit.decorators import make_kernel as kernel
from guidefield.kernels.prove.kept_distance import (
    FIRST_TURNS,
    FIRST_TWIST,
    LOG_ROWS,
    SECOND_TURNS,
    SECOND_TWIST,
    TWISTS,
    bodies_keep,
)
from guidefield.kernels.simd.packing import pointers

ACCURACY = 1e-5  # how far a distance by kernels, with corners in single precision, may be from Coal's [m]

INSTANTS = 41


@kernel(
    types.float64(
        PARTS, VECTOR, PARTS, VECTOR, VECTOR, types.float64, types.float64, types.float64, VECTOR_OUT, VECTOR_OUT
    )
)
def _keeps(
    a: Parts,
    pose_a: Floats,
    b: Parts,
    pose_b: Floats,
    twists: Floats,
    half: float,
    asked: float,
    bent: float,
    work: Floats,
    log: Floats,
) -> float:
    """`bodies_keep` of two bodies, each alone in its tables."""
    return bodies_keep(
        pointers(a),
        0,
        pointers(pose_a),
        pointers(b),
        0,
        pointers(pose_b),
        pointers(twists),
        half,
        asked,
        bent,
        pointers(work),
        pointers(log),
    )


def keeps(*arguments: Any) -> float:
    """Ask the kernel, without a log of what closes the bodies."""
    return float(_keeps(*arguments, np.zeros(LOG_ROWS)))


def shape_of(kind: str, rng: np.random.Generator) -> coal.CollisionGeometry:
    half = rng.uniform(0.03, 0.15, 3)
    if kind == "box":
        return coal.Box(*2.0 * half)
    if kind == "cylinder":
        return coal.Cylinder(half[0], 2.0 * half[2])
    if kind == "capsule":
        return coal.Capsule(half[0], 2.0 * half[2])
    if kind == "half-space":
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    return angle_of(half)


def angle_of(half: np.ndarray) -> coal.BVHModelOBBRSS:
    """Two boxes at right angles, as one mesh that isn't convex."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    faces = np.array(coal_faces(corners))
    arms = [corners * half * (1.0, 0.2, 1.0), corners * half * (0.2, 1.0, 1.0) + half * (0.8, 0.8, 0.0)]
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(24, 16)
    for arm in arms:
        for face in faces:
            mesh.addTriangle(*arm[face])
    mesh.endModel()
    return mesh


def coal_faces(corners: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangles of a cube's sides, by its corners (8, 3)."""
    faces = []
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        a, b, c, d = np.flatnonzero(corners[:, axis] == side)
        faces += [(a, b, c), (b, d, c)]
    return faces


def table_of(shape: coal.CollisionGeometry) -> Parts:
    table = PartsTable()
    table.add_shape(shape, pin.SE3.Identity())
    return table.tables()


def distance(one: coal.CollisionGeometry, at: pin.SE3, other: coal.CollisionGeometry, there: pin.SE3) -> float:
    places = [coal.Transform3s(place.rotation, place.translation) for place in (at, there)]
    return coal.distance(one, places[0], other, places[1], coal.DistanceRequest(), coal.DistanceResult())


def numbers(pose: pin.SE3) -> np.ndarray:
    return np.c_[pose.rotation, pose.translation].ravel()


def twists_of(one: pin.Motion, other: pin.Motion) -> np.ndarray:
    found = np.zeros(TWISTS)
    found[FIRST_TWIST : FIRST_TWIST + 6], found[SECOND_TWIST : SECOND_TWIST + 6] = one.vector, other.vector
    found[FIRST_TURNS], found[SECOND_TURNS] = np.linalg.norm(one.angular), np.linalg.norm(other.angular)
    return found


def bend_of(twist: pin.Motion, pose: pin.SE3, half: float) -> float:
    """A bound of how fast the velocities of a body's points change: they are all within 0.4 m of its origin."""
    turning = float(np.linalg.norm(twist.angular))
    fastest = float(np.linalg.norm(twist.linear + np.cross(twist.angular, pose.translation))) + 0.4 * turning
    return turning * fastest * (1.0 + turning * half)


def moved(twist: pin.Motion, time: float, pose: pin.SE3) -> pin.SE3:
    """Where a body is that has one twist in the world all the time."""
    return pin.exp6(twist * time) * pose


def given_bodies(seed: int, kinds: tuple[str, str]) -> tuple[list[Any], list[pin.SE3], np.random.Generator]:
    rng = np.random.default_rng(seed)
    away = rng.normal(size=3)
    poses = [pin.SE3.Random(), pin.SE3.Random()]
    for pose, side in zip(poses, (0.0, 1.0), strict=True):
        turn = pin.Quaternion(*(v := rng.normal(size=4)) / np.linalg.norm(v))
        pose.rotation = turn.toRotationMatrix()
        pose.translation = np.array([0.5, -0.2, 0.3]) + side * away / np.linalg.norm(away) * rng.uniform(0.1, 0.6)
    return [shape_of(kind, rng) for kind in kinds], poses, rng


FIRST = st.sampled_from(["box", "cylinder", "capsule", "mesh"])
SECOND = st.sampled_from(["box", "cylinder", "capsule", "mesh", "half-space"])


@settings(max_examples=90)
@given(st.integers(0, 10**6), FIRST, SECOND)
def test_what_is_kept_is_kept_at_all_times(seed: int, first: str, second: str) -> None:
    shapes, poses, rng = given_bodies(seed, (first, second))
    rests = second == "half-space" or bool(rng.integers(2))
    one = pin.Motion(rng.normal(size=6) * rng.uniform(0.0, 1.5))
    other = pin.Motion.Zero() if rests else pin.Motion(rng.normal(size=6) * rng.uniform(0.0, 1.5))
    half, middle = float(rng.choice([1e-3, 0.01, 0.05, 0.15])), distance(shapes[0], poses[0], shapes[1], poses[1])
    wanted = max(middle, 0.0) * rng.uniform(0.3, 1.0)
    bend = 0.5 * half**2 * (bend_of(one, poses[0], half) + bend_of(other, poses[1], half))
    tables = [table_of(shape) for shape in shapes]
    if second == "half-space":
        poses[1], tables[1] = pin.SE3.Identity(), placed_half_space(shapes[1], poses[1])
    found = keeps(
        tables[0], numbers(poses[0]), tables[1], numbers(poses[1]), twists_of(one, other), half,
        max(wanted + bend, 1e-6), bend,
        np.zeros(WORK),
    )  # fmt: skip
    if found < np.inf:
        return
    assert middle > 0.0
    shape = shapes[1]
    for time in np.linspace(-half, half, INSTANTS):
        there = moved(other, time, poses[1])
        assert distance(shapes[0], moved(one, time, poses[0]), shape, there) >= wanted - ACCURACY


def placed_half_space(shape: coal.Halfspace, pose: pin.SE3) -> Parts:
    """A half-space in the world: its pose goes into its plane, and from the shape's into it."""
    normal = pose.rotation @ shape.n
    shape.d += float(normal @ pose.translation)
    shape.n = normal
    table = PartsTable()
    table.add_shape(shape, pin.SE3.Identity())
    return table.tables()


@settings(max_examples=45)
@given(st.integers(0, 10**6), FIRST, st.sampled_from(["box", "cylinder", "capsule", "mesh"]))
def test_bodies_that_shift_together_keep_exactly_their_distance(seed: int, first: str, second: str) -> None:
    """However fast they are: then the distance decides, and where it isn't kept two leaves are named that are near."""
    shapes, poses, rng = given_bodies(seed, (first, second))
    apart = distance(shapes[0], poses[0], shapes[1], poses[1])
    if apart <= 1e-3:
        return
    both = pin.Motion(np.r_[rng.normal(size=3), np.zeros(3)])
    a, b = (table_of(shape) for shape in shapes)
    work = np.zeros(WORK)
    arguments = (a, numbers(poses[0]), b, numbers(poses[1]), twists_of(both, both), 0.3)
    assert keeps(*arguments, apart - 2.0 * ACCURACY, 0.0, work) == np.inf
    left = keeps(*arguments, apart + 2.0 * ACCURACY, 0.0, work)
    assert apart - ACCURACY <= left < np.inf
    assert keeps(*arguments, apart - 2.0 * ACCURACY, 0.0, work) == np.inf  # what was left last is tried first


@settings(max_examples=45)
@given(st.integers(0, 10**6), st.sampled_from(["box", "mesh"]), st.sampled_from(["capsule", "mesh"]))
def test_what_is_told_later_is_told_in_a_shorter_time(seed: int, first: str, second: str) -> None:
    """Nodes that would be told soon aren't divided: that doesn't go on for ever, nor is what is too near ever told."""
    shapes, poses, rng = given_bodies(seed, (first, second))
    middle = distance(shapes[0], poses[0], shapes[1], poses[1])
    if middle <= 1e-2:
        return
    one, other = (pin.Motion(rng.normal(size=6)) for _ in range(2))
    tables, asked = [table_of(shape) for shape in shapes], rng.uniform(0.5, 0.99) * middle
    half, work = 1.0, np.zeros(WORK)
    bend = 0.5 * half**2 * (bend_of(one, poses[0], half) + bend_of(other, poses[1], half))
    arguments = (tables[0], numbers(poses[0]), tables[1], numbers(poses[1]), twists_of(one, other))
    for _ in range(40):
        if keeps(*arguments, half, asked + bend, bend, work) == np.inf:
            break
        assert keeps(*arguments, half, middle + bend + ACCURACY, bend, work) < np.inf
        half, bend = 0.5 * half, 0.25 * bend
    else:
        raise AssertionError("it is never told")


EDGE = np.array(
    [
        [-0.05133077, 0.16003193, -0.0119238],
        [-0.03140953, 0.15953004, -0.00842417],
        [-0.03984806, 0.17532482, 0.01948162],
    ]
)
"""A triangle with an edge that is nearly a tangent of a cylinder's side, 5 um from it, in the cylinder's frame."""


def test_no_axis_to_begin_with_makes_parts_touch_that_are_separated() -> None:
    """Of a flat simplex rounding says where the origin is: from the first of these axes it was within it."""
    cylinder, mesh = table_of(coal.Cylinder(0.162587246, 0.80723663)), coal.BVHModelOBBRSS()
    mesh.beginModel(1, 3)
    mesh.addTriangle(*EDGE)
    mesh.endModel()
    triangle, still = table_of(mesh), twists_of(pin.Motion.Zero(), pin.Motion.Zero())
    exact = [-0.1452751933493983, 0.6069085761146729, 0.7813815319264688, -0.14978307124153725, -0.8802009834937949]
    exact += [0.2813760110863194, -0.3821959825033585, -0.018882572578070966, -0.45182003812784904, -0.7432963881411045]
    at = np.array([*exact, 0.4933245711725064, 0.08100070348517124])
    outwards = at.reshape(3, 4)[:, :3] @ [-0.25, 0.97, 0.0]
    rng = np.random.default_rng(0)
    sizes, sides = 10.0 ** rng.uniform(-7.0, -2.0, 3000), rng.choice([-1.0, 1.0], 3000)
    axes = sides[:, None] * outwards + 10.0 ** rng.uniform(-6.0, 0.5, (3000, 1)) * rng.normal(size=(3000, 3))
    found = [[-3.5164709716773195e-05, -2.731831793570893e-05, 3.2392857404689596e-05]]
    for axis in np.concatenate([found, sizes[:, None] * axes]):
        work = np.zeros(WORK)
        work[AXIS : AXIS + 3] = axis
        assert 5e-6 < keeps(cylinder, at, triangle, at, still, 0.1, 1e-3, 0.0, work) < 6e-6


def test_a_fast_body_that_passes_by_is_told_from_one_that_comes_closer() -> None:
    """A box slides along a face at 2 m/s, 10 mm above it: a bound of its speed alone would say nothing."""
    box, ground = coal.Box(0.1, 0.1, 0.1), coal.Box(4.0, 4.0, 0.2)
    poses = pin.SE3(np.eye(3), np.array([0.2, 0.1, 0.06])), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1]))
    along, down = (pin.Motion(np.r_[v, np.zeros(3)]) for v in ([2.0, 0.0, 0.0], [2.0, 0.0, -0.01]))
    still = pin.Motion.Zero()

    def kept(twist: pin.Motion, asked: float) -> float:
        return keeps(
            table_of(box), numbers(poses[0]), table_of(ground), numbers(poses[1]), twists_of(twist, still), 0.1, asked,
            0.0, np.zeros(WORK),
        )  # fmt: skip

    assert kept(along, 0.01 - ACCURACY) == np.inf
    assert kept(down, 0.01 - ACCURACY) < np.inf
    assert kept(down, 0.009 - ACCURACY) == np.inf
