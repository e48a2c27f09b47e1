"""A slab tells apart only what Coal says is farther apart than the margin, and nearly all that is much farther."""

import numpy as np
import pytest

from guidefield.kernels.certificate.slabs import UNKNOWN
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.prove.certified_tables import certified_robot
from tests.collision.scenery import box, scattered, world_of
from tests.prove.test_near import apart_at_most, found, placed
from tests.robots import box_arm, group, grouped

FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-1.1)

TETRAHEDRON = messages.Mesh(
    name="tetrahedron",
    vertices=[(0.3, 0.3, 0.3), (0.5, 0.3, 0.2), (0.3, 0.5, 0.2), (0.3, 0.35, 0.6)],
    triangles=[(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
)

_TURNED = '<origin xyz="0.03 -0.02 0.1" rpy="0.4 -0.7 1.1"/>'
_SHAPES = ('<sphere radius="0.07"/>', '<cylinder radius="0.05" length="0.2"/>', '<box size="0.05 0.12 0.2"/>')


def primitive_arm():
    """A chain whose links are balls, cylinders and boxes, all of them turned in their frames."""
    text = box_arm("y", 6).text
    for index in range(7):
        first, rest = text.split("<collision><origin xyz", 1)
        _, rest = rest.split("</collision>", 1)
        text = f"{first}<collision >{_TURNED}<geometry>{_SHAPES[index % 3]}</geometry></collision >{rest}"
    return grouped(UrdfText(text=text))


def judged(world, rng, margins):
    """Distance by Coal, of hulls, and whether the pair is asked with a margin: of pairs that are not far from that."""
    joints, centres = placed(world, rng, 12)
    told = []
    for row in range(len(joints)):
        world.put_joints(joints[row])
        for pair in range(len(world.pairs)):
            apart = world.hull_distance(pair)
            if not 0.001 < apart < 0.4:
                continue
            margin = margins(apart)
            own, mixed = np.full((1, world.pairs.n_self), margin), np.full((1, world.pairs.links), margin)
            _, asked = found(world, joints[row : row + 1], centres[row : row + 1], own, mixed, [[pair]])
            told.append((apart, asked == 1))
    return told


def worlds(rng, more=(FLOOR, TETRAHEDRON)):
    """Meshes, hulls and primitives among primitives, and a floor and a mesh."""
    scene = [*scattered(rng, 12), *more]
    return [world_of(one, scene) for one in (group("panda"), group("ur5"), primitive_arm())]


@pytest.mark.parametrize("seed", range(2))
def test_no_pair_is_told_apart_that_is_closer_than_its_margin(seed):
    rng = np.random.default_rng(seed)
    for world in worlds(rng):
        told = judged(world, rng, lambda apart: apart + 3e-6 * (1.0 + apart))
        assert len(told) > 200
        assert all(asked for _, asked in told)


def test_primitives_that_are_twice_as_far_apart_as_their_margin_are_hardly_asked_about():
    rng = np.random.default_rng(7)
    for world in worlds(rng, ()):
        told = judged(world, rng, lambda apart: 0.5 * apart)
        assert np.mean([asked for _, asked in told]) < 0.05


def test_bodies_are_no_farther_apart_than_is_told_where_coal_is_not_asked():
    rng = np.random.default_rng(11)
    for world in worlds(rng):
        (joints, centres), off = placed(world, rng, 8), []
        for row in range(len(joints)):
            world.put_joints(joints[row])
            for pair in rng.choice(len(world.pairs), 40, replace=False).tolist():
                apart = max(world.hull_distance(pair), 0.0)
                margin = 2.0 * apart + 0.01
                told = apart_at_most(world, joints[row : row + 1], centres[row : row + 1], pair, margin)
                if told <= margin:
                    assert told >= apart - 3e-6 * (1.0 + apart)
                    off.append((told - apart) / margin)
        assert len(off) > 100
        assert np.mean(np.array(off) <= 0.11) > 0.95


def test_bodies_that_overlap_are_told_to_be_within_any_margin():
    world = world_of(group("panda"), [box("block", (0.6, 0.6, 1.2), (0.0, 0.0, 0.6))])
    (joints, centres), deep = placed(world, np.random.default_rng(5), 4), 0
    for row in range(len(joints)):
        world.put_joints(joints[row])
        for pair in range(world.pairs.n_self, len(world.pairs)):
            if world.hull_distance(pair) < -1e-3:
                deep += 1
                assert apart_at_most(world, joints[row : row + 1], centres[row : row + 1], pair, 1e-4) <= 1e-6
    assert deep > 10


def test_of_a_mesh_that_its_box_stands_for_it_is_not_told_how_far_it_is():
    world = world_of(group("panda"), [TETRAHEDRON])
    joints, centres = placed(world, np.random.default_rng(2), 1)
    pair = len(world.pairs) - 1
    assert world.pair_names(pair)[1] == "tetrahedron"
    assert apart_at_most(world, joints, centres, pair, 5.0) == UNKNOWN


def test_the_core_of_each_body_holds_its_shape():
    rng = np.random.default_rng(3)
    for world in worlds(rng):
        robot = certified_robot(world)
        for index, shape in enumerate(world.group.geometry.geometryObjects):
            corners = robot.corners[robot.corners_from[index] : robot.corners_from[index + 1]]
            assert len(corners)
            for drawn in rng.normal(size=(50, 3)):
                across = drawn / np.linalg.norm(drawn)
                off = np.linalg.norm(np.cross(robot.disc_axes[index], across))
                core = (corners @ across).max() + robot.discs[index] * off + robot.rounded[index]
                there = shape.placement.rotation.T @ across
                reach = _reach(world, index, there) + shape.placement.translation @ across
                assert core == pytest.approx(reach, abs=1e-9)


def _reach(world, index, across):
    """How far the hull of a body goes along a direction (3,) of its frame, by what it is declared to be [m]."""
    shape = world.hulls.shape(index)
    kind = type(shape).__name__
    if kind == "Sphere":
        return shape.radius
    if kind == "Cylinder":
        return shape.halfLength * abs(across[2]) + shape.radius * np.hypot(across[0], across[1])
    if kind == "Box":
        return np.abs(across) @ shape.halfSide
    return (np.asarray(shape.points()) @ across).max()
