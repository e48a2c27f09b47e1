"""Balls contain bodies, and the lower bounds of distances are below them."""

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
from tests.collision.listed import are_signed, part_separations
from tests.collision.scenery import panda_in, scattered, world_of
from tests.collision.test_world import SCENES, pair_distances
from tests.robots import box_arm, group, grouped, random_configuration, robot
from tests.scene.solids import l_prism


def centres(world, q):
    pin.forwardKinematics(world.model, world.data, world.group.expand(q))
    return world.bodies.centres_in_world(world.joint_placements)


@settings(deadline=None, max_examples=12)
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
