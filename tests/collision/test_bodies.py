"""Balls and the reach ball contain bodies; separations are lower bounds; no motion exceeds its bound."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st

from guidefield.collision.bodies import bodies, bounding_ball, joint_placements, parts_of, reach_ball
from guidefield.collision.clearance import separations
from guidefield.geometry.convex import bvh
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from tests.collision.plain import are_signed, listed, part_separations
from tests.collision.scenery import box, panda_in, scattered, world_of
from tests.collision.test_world import SCENES, pair_distances
from tests.robots import box_arm, group, grouped, random_configuration, robot
from tests.scene.solids import l_prism


def centres(world, q):
    pin.forwardKinematics(world.model, world.data, world.group.expand(q))
    return world.bodies.centres_in_world(world.joint_placements)


@settings(max_examples=12)
@given(st.sampled_from((*SCENES, "strewn")), st.integers(0, 10**6))
@example("wall_with_window", 3795)  # one in eleven, of a quarter usually
def test_separations_of_parts_are_lower_bounds_and_many_are_closer(name, seed):
    world = panda_in(name) if name != "strewn" else world_of(group("panda"), scattered(np.random.default_rng(seed), 12))
    pairs = np.arange(len(world.pairs))
    qs = [random_configuration(world.group, seed + k) for k in range(2)]
    for q in qs:
        by_balls = separations(world, centres(world, q), pairs)
        bounds = part_separations(world, world.joint_placements, pairs)
        distances = pair_distances(world, q)
        distances[~are_signed(world)] = np.maximum(distances[~are_signed(world)], 0.0)
        assert (bounds <= distances + 2e-6).all()
        assert (bounds > np.maximum(by_balls, 0.0) + 5e-3).mean() > 0.05


def swollen(shape, by):
    shape.setSweptSphereRadius(by)
    return shape


SHAPES = {
    "sphere": coal.Sphere(0.2),
    "capsule": coal.Capsule(0.1, 0.4),
    "cylinder": coal.Cylinder(0.1, 0.4),
    "box": coal.Box(0.1, 0.2, 0.3),
    "ellipsoid": coal.Ellipsoid(0.1, 0.2, 0.3),
    "cone": coal.Cone(0.2, 0.5),
    "mesh": bvh(*l_prism()),
    "swollen": swollen(coal.Box(0.1, 0.2, 0.3), 0.05),
}


@pytest.mark.parametrize("name", SHAPES)
def test_nothing_of_a_shape_is_outside_its_ball(name):
    shape = SHAPES[name]
    centre, radius = bounding_ball(shape)
    # A plane tangent to the ball must not cut the shape, from wherever it comes.
    for normal in np.random.default_rng(0).normal(size=(300, 3)):
        n = normal / np.linalg.norm(normal)
        beyond = coal.Halfspace(-n, -(n @ centre + radius) - 1e-9)
        here = coal.Transform3s.Identity()
        assert not coal.collide(beyond, here, shape, here, coal.CollisionRequest(), coal.CollisionResult())


@pytest.mark.parametrize("name", SHAPES)
def test_nothing_of_a_shape_is_outside_the_balls_about_its_parts(name):
    shape = SHAPES[name]
    centres_of, radius = parts_of(shape)
    rng = np.random.default_rng(1)
    extent = np.abs(centres_of).max() + radius
    probe, request = coal.Sphere(1e-6), coal.CollisionRequest()
    for point in rng.uniform(-extent, extent, (2000, 3)):
        if np.linalg.norm(centres_of - point, axis=1).min() > radius + 1e-5:
            there = coal.Transform3s(np.eye(3), point)
            assert not coal.collide(probe, there, shape, coal.Transform3s.Identity(), request, coal.CollisionResult())


TURNED = pin.SE3(pin.exp3(np.array([0.3, -0.8, 1.1])), np.array([1.0, -2.0, 0.5]))


def farthest(planned: PlanningGroup, seeds: int) -> float:
    """How far from the ball's centre the balls about bodies reach at random configurations [m]."""
    ball, about, data, reached = reach_ball(planned), bodies(planned), planned.model.createData(), 0.0
    for seed in range(seeds):
        pin.forwardKinematics(planned.model, data, planned.expand(random_configuration(planned, seed)))
        centres = about.centres_in_world(joint_placements(data)[None])[0]
        reached = max(reached, float((np.linalg.norm(centres - ball[:3], axis=1) + about.radii).max()))
    return reached


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "tiago", "baxter"])
def test_robots_stay_in_it_wherever_they_stand(name: str) -> None:
    model = robot(name)
    for base in (pin.SE3.Identity(), TURNED):
        planned = select(model, None, None, model.rest, base)
        ball = reach_ball(planned)
        assert 0.5 * ball.radius < farthest(planned, 200) <= ball.radius


@pytest.mark.parametrize("joints", ["x oblique slide y screw", "slide slide slide", "continuous mimic gear x", "slide"])
def test_chains_of_every_kind_stay_in_it(joints: str) -> None:
    planned = grouped(box_arm(joints, 3))
    ball = reach_ball(planned)
    assert farthest(planned, 300) <= ball.radius


@pytest.mark.parametrize("joints", ["planar x", "x floating", "x planar y"])
def test_what_may_go_anywhere_has_none(joints: str) -> None:
    assert reach_ball(grouped(box_arm(joints, 2))) is None


def test_a_joint_that_slides_beyond_its_limits_may_go_anywhere() -> None:
    assert reach_ball(grouped(box_arm("x slide", 2)), limited=False) is None
    assert reach_ball(group("panda"), limited=False) == reach_ball(group("panda"))


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
    q = planned.expand_from_local(middle)
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
    pin.forwardKinematics(place.model, data, planned.expand_from_local(z))
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


@settings(max_examples=18)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_no_point_moves_further_than_the_bound(name, seed):
    place, rng = world(name), np.random.default_rng(seed)
    middle, half_widths = random_box(place, rng)
    bounds = bounds_at(place, middle, half_widths)
    for z in extremes(rng, middle, half_widths):
        moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
        assert (moved <= bounds[place.pairs.n_self :] + 1e-9).all()


@pytest.mark.parametrize("turn", [-np.pi, np.pi, 3.0 * np.pi])
def test_mimic_joints_don_t_jump_where_their_source_passes_half_a_turn(turn):
    place, rng = world("followed on and on"), np.random.default_rng(0)
    for _ in range(10):
        middle, half_widths = random_box(place, rng)[0], np.full(place.group.nv, 0.05)
        middle[0] = turn + rng.uniform(-0.04, 0.04)
        bounds = bounds_at(place, middle, half_widths)
        for z in extremes(rng, middle, half_widths):
            moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
            assert (moved <= bounds[place.pairs.n_self :] + 1e-9).all()


@settings(max_examples=15)
@given(st.sampled_from(sorted(ARMS.keys() - {"kinova"})), st.integers(0, 10**6))
def test_no_pair_comes_closer_by_more_than_the_bound(name, seed):
    place, rng = world(name), np.random.default_rng(seed)
    middle, half_widths = random_box(place, rng)
    bounds = bounds_at(place, middle, half_widths)
    planned = place.group
    before = np.maximum(pair_distances(place, planned.from_local(middle)), 0.0)
    for z in extremes(rng, middle, half_widths):
        after = np.maximum(pair_distances(place, planned.from_local(z)), 0.0)
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


def test_a_mimic_joint_counts_with_its_multiplier():
    place = world_of(grouped(box_arm("y mimic", 0)), [box("crate", (0.1, 0.1, 0.1), (2, 0, 0))])
    assert place.group.nv == 1
    bounds = bounds_at(place, np.zeros(1), np.array([0.4]))
    names = [place.pair_names(k) for k in range(len(place.pairs))]
    last = bounds[names.index(("l2", "crate"))]
    # q = 0 puts the mimic joint at its offset; both axes run through known places on z.
    tip = np.array([np.sin(0.2), np.cos(0.2)]) * 0.15 + [0, 0.3]
    radius = np.linalg.norm([0.02, 0.02, 0.135])
    expected = 2 * np.sin(0.2) * (np.linalg.norm(tip) + radius) + 2 * np.sin(0.1) * (0.15 + radius)
    assert last == pytest.approx(expected)
