"""The pairs that Coal is asked about are among those that going through all of them leaves, whatever is left of a part.

What slabs tell apart is missing of them: `test_slabs` is about that.
"""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.certificate.near import ASKED, find_near
from guidefield.messages import scene as messages
from guidefield.prove.certified_tables import certified_obstacles, certified_robot
from tests.collision.listed import listed
from tests.collision.scenery import box, scattered, world_of
from tests.robots import group

FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.4)


def crowded(rng):
    """A Panda among more obstacles than one level of a tree holds, some pairs left out, one obstacle without end."""
    places = rng.uniform(-1.2, 1.2, (300, 3)).tolist()
    crumbs = [box(f"c{k}", rng.uniform(0.01, 0.1, 3), place) for k, place in enumerate(places)]
    return world_of(group("panda"), [*crumbs, FLOOR], [("panda_link3", "c7"), ("panda_hand", "floor")])


def placed(world, rng, count):
    """Joints and centres of balls at random configurations."""
    joints = np.empty((count, world.model.njoints, 3, 4))
    for row in range(count):
        pin.forwardKinematics(world.model, world.data, world.group.expand(world.group.random(rng)))
        joints[row] = world.joint_placements
    return joints, np.ascontiguousarray(world.bodies.centres_in_world(joints))


def found(world, joints, centres, own, mixed, left=None, robot=None):
    """Part and pair of what the kernel finds, and how many it says there are; `robot`: other tables of the robot's."""
    some = [[]] * len(joints) if left is None else left
    every = np.array([pair for pairs in some for pair in pairs], np.int64)
    rows = np.column_stack([every, world.pairs.bodies(every)])
    starts, asked = np.cumsum([0, *map(len, some)]), np.empty((10_000, ASKED), np.int64)
    arguments = joints.reshape(*joints.shape[:2], 12), centres, own, mixed, starts, rows, asked, np.empty(10_000)
    count = find_near(robot or certified_robot(world), certified_obstacles(world), *arguments)
    for _, pair, *bodies in asked[:count].tolist():
        assert tuple(bodies) == world.pairs.of(pair)
    return sorted(map(tuple, asked[:count, :2].tolist())), count


def apart_at_most(world, joints, centres, pair, margin):
    """How far a pair is apart at most at one configuration, as the kernel tells it where it doesn't keep a margin."""
    asked, told = np.empty((1, ASKED), np.int64), np.empty(1)
    own, mixed = np.full((1, world.pairs.n_self), margin), np.full((1, world.pairs.links), margin)
    rows = np.column_stack([[pair], world.pairs.bodies(np.array([pair]))])
    arguments = joints.reshape(1, -1, 12), centres, own, mixed, np.array([0, 1]), rows, asked, told
    count = find_near(certified_robot(world), certified_obstacles(world), *arguments)
    return told[0] if count else np.inf


def going_through_all(world, joints, centres, own, mixed):
    """The same by looking at every pair."""
    bodies, near = listed(world), []
    every = np.arange(len(bodies))
    for row in range(len(joints)):
        margins = np.concatenate([own[row], mixed[row][bodies[world.pairs.n_self :, 0]]])
        at = np.full(len(every), row)
        one, other = (
            world.near_pairs.separations(centres, at, every),
            world.near_pairs.closer_separations(joints, at, every),
        )
        near += [(row, pair) for pair in np.flatnonzero((one <= margins) & (other <= margins)).tolist()]
    return near


def without_cores(world):
    """The tables of a robot of which no slab tells anything, since nothing is known to hold its bodies."""
    robot = certified_robot(world)
    nowhere = np.zeros_like(robot.corners_from)
    nowhere.flags.writeable = False
    return robot._replace(corners_from=nowhere)


@pytest.mark.parametrize("seed", range(3))
def test_without_slabs_the_pairs_found_are_those_that_going_through_all_leaves(seed):
    rng = np.random.default_rng(seed)
    for world in (crowded(rng), world_of(group("panda"), scattered(rng, 6)), world_of(group("panda"), [FLOOR])):
        joints, centres = placed(world, rng, 5)
        own = rng.uniform(0.0, 0.1, (5, world.pairs.n_self))
        mixed = rng.uniform(0.0, 0.1, (5, world.pairs.links))
        expected = going_through_all(world, joints, centres, own, mixed)
        tables = without_cores(world)
        assert found(world, joints, centres, own, mixed, robot=tables)[0] == expected
        left = [sorted(rng.choice(len(world.pairs), 30, replace=False).tolist()) for _ in range(5)]
        left[2] = []  # none was judged before: all are meant
        among = [(row, pair) for row, pair in expected if not left[row] or pair in left[row]]
        assert found(world, joints, centres, own, mixed, left, tables)[0] == among
        closer = set(found(world, joints, centres, own, mixed)[0])
        assert closer <= set(expected)
        assert found(world, joints, centres, own, mixed, left)[0] == [one for one in among if one in closer]


def test_pairs_without_room_are_counted():
    rng = np.random.default_rng(4)
    world = crowded(rng)
    joints, centres = placed(world, rng, 2)
    own, mixed = np.full((2, world.pairs.n_self), 0.1), np.full((2, world.pairs.links), 0.1)
    every, count = found(world, joints, centres, own, mixed)
    assert len(every) == count > 40
    asked = np.full((40, ASKED), -1, np.int64)
    nothing = np.zeros(3, np.int64), np.empty((0, 3), np.int64)
    arguments = joints.reshape(2, -1, 12), centres, own, mixed, *nothing, asked, np.empty(40)
    assert find_near(certified_robot(world), certified_obstacles(world), *arguments) == count
    assert set(map(tuple, asked[:, :2].tolist())) < set(every)
