"""The certificate's bound: never exceeded by any motion within a box, and not far above what happens."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from tests.collision.listed import listed
from tests.collision.scenery import box, scattered, world_of
from tests.collision.test_world import pair_distances
from tests.robots import box_arm, group, grouped

ARMS = {
    "panda": lambda: group("panda"),
    "kinova": lambda: group("kinova"),
    "oblique": lambda: grouped(box_arm("oblique", 4)),
    "sliding": lambda: grouped(box_arm("slide y slide x", 0)),
    "followed": lambda: grouped(box_arm("y x mimic mimic", 0)),
    "followed on and on": lambda: grouped(box_arm("continuous x screw half-gear", 0)),
    "planar": lambda: grouped(box_arm("y planar x", 0)),
    "floating": lambda: grouped(box_arm("floating y", 0)),
    "balls": lambda: group("chain_fixed_6x300_r25"),
    "snake": lambda: group("chain_moving_3x260_r20"),
    "turning": lambda: grouped(box_arm("continuous continuous y", 0)),
}
WORLDS = {}


def world(name):
    if name not in WORLDS:
        WORLDS[name] = world_of(ARMS[name](), scattered(np.random.default_rng(2), 6))
    return WORLDS[name]


def bounds_at(place, middle, half_widths):
    planned = place.group
    q = planned.expand_from_chart(middle)
    jacobian = pin.computeJointJacobians(place.model, place.data, q)
    centres = place.bodies.centres_in_world(place.joint_placements)
    own, mixed = place.motion_bound.at(jacobian.reshape(1, 6, -1), centres[None], half_widths[None])
    return np.concatenate([own[0], mixed[0][listed(place)[place.pairs.n_self :, 0]]])


def corners(shape) -> np.ndarray:
    """Points of a robot's body in its own frame."""
    if hasattr(shape, "halfSide"):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * shape.halfSide
    if hasattr(shape, "halfLength"):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * [0.5 * shape.radius, 0.5 * shape.radius, shape.halfLength]
    return np.array(shape.points()) if hasattr(shape, "points") else np.array(shape.vertices())[::29]


def placed(place, z) -> list[pin.SE3]:
    planned, data = place.group, place.model.createData()
    pin.forwardKinematics(place.model, data, planned.expand_from_chart(z))
    return [data.oMi[shape.parentJoint] * shape.placement for shape in planned.geometry.geometryObjects]


def random_box(place, rng):
    planned = place.group
    low = np.where(np.isfinite(planned.lower), planned.lower, -np.pi)
    high = np.where(np.isfinite(planned.upper), planned.upper, np.pi)
    return rng.uniform(low, high), rng.uniform(0, rng.choice([0.02, 0.3, 4.0]), planned.nv) * (
        rng.random(planned.nv) < 0.7
    )


def extremes(rng, middle, half_widths):
    """Configurations in the box, its corners among them."""
    inside = rng.uniform(-1, 1, (6, len(middle)))
    return middle + half_widths * np.vstack([inside, rng.choice([-1.0, 1.0], (6, len(middle)))])


def travels(place, middle, z) -> np.ndarray:
    """The longest way of a corner of each robot body from one configuration to another, shape (r,)."""
    before, after = placed(place, middle), placed(place, z)
    longest = []
    for shape, there, here in zip(place.group.geometry.geometryObjects, before, after, strict=True):
        points = corners(shape.geometry)
        way = points @ (here.rotation - there.rotation).T + here.translation - there.translation
        longest.append(np.linalg.norm(way, axis=1).max())
    return np.array(longest)


@settings(deadline=None, max_examples=18)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_no_point_moves_further_than_the_bound(name, seed):
    place, rng = world(name), np.random.default_rng(seed)
    middle, half_widths = random_box(place, rng)
    bounds = bounds_at(place, middle, half_widths)
    for z in extremes(rng, middle, half_widths):
        moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
        assert (moved <= bounds[place.pairs.n_self :] + 1e-9).all()


@pytest.mark.parametrize("turn", [-np.pi, np.pi, 3.0 * np.pi])
def test_followers_don_t_jump_where_their_driver_passes_half_a_turn(turn):
    place, rng = world("followed on and on"), np.random.default_rng(0)
    for _ in range(10):
        middle, half_widths = random_box(place, rng)[0], np.full(place.group.nv, 0.05)
        middle[0] = turn + rng.uniform(-0.04, 0.04)
        bounds = bounds_at(place, middle, half_widths)
        for z in extremes(rng, middle, half_widths):
            moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
            assert (moved <= bounds[place.pairs.n_self :] + 1e-9).all()


@settings(deadline=None, max_examples=15)
@given(st.sampled_from(sorted(ARMS.keys() - {"kinova"})), st.integers(0, 10**6))
def test_no_pair_comes_closer_by_more_than_the_bound(name, seed):
    place, rng = world(name), np.random.default_rng(seed)
    middle, half_widths = random_box(place, rng)
    bounds = bounds_at(place, middle, half_widths)
    planned = place.group
    before = np.maximum(pair_distances(place, planned.from_chart(middle)), 0.0)
    for z in extremes(rng, middle, half_widths):
        after = np.maximum(pair_distances(place, planned.from_chart(z)), 0.0)
        assert (before - after <= bounds + 2e-6).all()


@pytest.mark.parametrize("name", ["panda", "sliding", "followed"])
def test_the_bound_is_not_far_above_what_happens(name):
    place, rng = world(name), np.random.default_rng(1)
    best = 0.0
    for _ in range(40):
        middle, half_widths = random_box(place, rng)
        bounds = bounds_at(place, middle, np.minimum(half_widths, 0.3))[place.pairs.n_self :]
        for z in extremes(rng, middle, np.minimum(half_widths, 0.3)):
            moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
            best = max(best, (moved[bounds > 1e-6] / bounds[bounds > 1e-6]).max(initial=0.0))
    assert 0.75 < best <= 1.0 + 1e-9


def test_only_joints_between_two_links_count():
    place = world("panda")
    shoulder = np.zeros(7)
    shoulder[0] = 0.3
    bounds = bounds_at(place, np.array([0, -0.785, 0, -2.356, 0, 1.571, 0.785]), shoulder)
    for k in range(place.pairs.n_self):
        expected = 0.0 if "panda_link0" not in place.pair_names(k) else None
        assert bounds[k] == 0.0 if expected == 0.0 else bounds[k] > 0.0
    assert (bounds[place.pairs.n_self :] > 0.0).all()


def test_a_turn_beyond_half_a_circle_is_half_a_circle():
    arm = grouped(box_arm("continuous", 1))
    place = world_of(arm, [box("crate", (0.1, 0.1, 0.1), (2, 0, 0))])
    half, more = (bounds_at(place, np.zeros(1), np.array([width])) for width in (np.pi, 9.0))
    assert half == pytest.approx(more)
    centre = 0.15
    radius = np.linalg.norm([0.02, 0.02, 0.135])
    assert half == pytest.approx(2 * (centre + radius))


def test_a_slide_counts_as_it_is():
    place = world_of(grouped(box_arm("slide", 1)), [box("crate", (0.1, 0.1, 0.1), (2, 0, 0))])
    assert bounds_at(place, np.zeros(1), np.array([0.25])) == pytest.approx(0.25)


def test_a_follower_counts_with_its_multiplier():
    place = world_of(grouped(box_arm("y mimic", 0)), [box("crate", (0.1, 0.1, 0.1), (2, 0, 0))])
    assert place.group.nv == 1
    bounds = bounds_at(place, np.zeros(1), np.array([0.4]))
    names = [place.pair_names(k) for k in range(len(place.pairs))]
    last = bounds[names.index(("l2", "crate"))]
    # q = 0 puts the follower at its offset; both axes run through known places on z.
    tip = np.array([np.sin(0.2), np.cos(0.2)]) * 0.15 + [0, 0.3]
    radius = np.linalg.norm([0.02, 0.02, 0.135])
    expected = 2 * np.sin(0.2) * (np.linalg.norm(tip) + radius) + 2 * np.sin(0.1) * (0.15 + radius)
    assert last == pytest.approx(expected)
