"""A slab tells apart only what Coal says is farther apart than the margin, and nearly all that is much farther."""

import numpy as np
import pytest

from guidefield.collision.certify.tables import certified_robot
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from tests.collision.certify.test_near import found, placed
from tests.collision.scenery import scattered, world_of
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
