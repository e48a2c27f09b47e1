"""Random robots of every kind of joint load, agree with Pinocchio on the URDF as written, and are planned for."""

import os
import random
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings, strategies as st

from guidefield.engine import Engine
from guidefield.kernels.kinematics.forward_kinematics import joint_placements
from guidefield.messages.requests import JointsGoal, PlanRequest, UrdfText
from guidefield.messages.scene import Scene, Sphere
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.model.model import RobotModel, joint_table
from guidefield.robot.model.pairs import scratch_space
from tests.robot.by_formula import ByFormula, given_by
from tests.robot.random_chains import KINDS, WOUND, chain, chains
from tests.robots import load

EXAMPLES = int(os.environ.get("GUIDEFIELD_RANDOM_CHAINS", "0"))
"""How many robots are drawn, if not a few; `tools/random_chains` sets it."""
EXACT = 1e-12  # rounding of a chain of twenty joints [m], and of a rotation's entries
RADIUS = 0.05
SEEDS = {1: 1, 4: 2, 8: 3, 12: 4, 16: 5, 17: 6, 20: 7}
"""How many joints robots have that are always planned for, and what they are drawn with."""
APART = 0.05  # how far apart configurations are that are looked at [rad or m]
DENSE = 300.0  # samples of a motion that are looked at [1/s]
ENGINE = Engine()
THOROUGH = settings(
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
)


def movable(robot: RobotModel) -> list[str]:
    return [joint.name for joint in robot.joints if joint.mimic is None]


@settings(THOROUGH, max_examples=EXAMPLES or 15)
@given(chains(), st.integers(0, 2**16))
def test_frames_are_where_pinocchio_has_them(urdf: UrdfText, seed: int) -> None:
    robot = load(urdf)
    assume(movable(robot))
    group = select(robot, movable(robot), None, robot.rest, pin.SE3.Identity())
    table = joint_table(group.model)
    found = np.empty((group.model.njoints, 3, 4))
    q = group.random(np.random.default_rng(seed))
    q_model = np.ascontiguousarray(group.expand(q))
    joint_placements(table, q_model, found)
    expected = ByFormula(urdf.text).placements(values(robot, group, q))
    for frame in group.model.frames:
        if frame.type == pin.FrameType.JOINT and group.model.names[frame.parentJoint] == frame.name:
            joint = pin.SE3(found[frame.parentJoint][:, :3], found[frame.parentJoint][:, 3]) * frame.placement
            np.testing.assert_allclose(joint.homogeneous, expected[frame.name], rtol=0.0, atol=EXACT)


class Looking:
    """Coal on the shapes of a URDF as Pinocchio reads it, with spheres: knows nothing of ours but pairs left out."""

    def __init__(self, robot: RobotModel, urdf: UrdfText, spheres: list[Sphere]) -> None:
        self._formula = ByFormula(urdf.text)
        self._model = self._formula.model
        self._geometry = pin.GeometryModel()
        pin.buildGeomFromUrdfString(self._model, self._formula.text, pin.GeometryType.COLLISION, self._geometry, [])
        self._geometry.addAllCollisionPairs()
        bodies = self._geometry.geometryObjects
        names = [self._model.frames[body.parentFrame].name for body in bodies]
        out = {frozenset(pair.links) for pair in robot.pairs_left_out}
        kept = [p for p in self._geometry.collisionPairs if frozenset((names[p.first], names[p.second])) not in out]
        kept = [pin.CollisionPair(pair.first, pair.second) for pair in kept]
        self._geometry.removeAllCollisionPairs()
        for pair in kept:
            self._geometry.addCollisionPair(pair)
        moving = [index for index, body in enumerate(bodies) if body.parentJoint]
        for sphere in spheres:
            placement = pin.SE3(np.eye(3), np.array(sphere.position))
            body = pin.GeometryObject(sphere.name, 0, placement, coal.Sphere(sphere.radius))
            added = self._geometry.addGeometryObject(body)
            for index in moving:
                self._geometry.addCollisionPair(pin.CollisionPair(index, added))
        self._data, self._geometry_data = self._model.createData(), scratch_space(self._geometry)

    def touches(self, positions: dict[str, Any]) -> bool:
        """Whether anything touches at values of the joints that follow none."""
        at = self._formula.configuration(positions)
        return bool(pin.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, at, True))

    def centres(self, positions: dict[str, Any]) -> np.ndarray:
        """Where the moving joints are, shape (n, 3)."""
        return np.array([T[:3, 3] for T in self._formula.placements(positions).values()])


def values(robot: RobotModel, group: PlanningGroup, q: np.ndarray) -> dict[str, Any]:
    """Values on the wire of all joints that follow none, those outside the group at rest."""
    return {**configuration_to_wire(robot.joints, robot.rest), **configuration_to_wire(group.joints, q)}


def free_walk(robot: RobotModel, group: PlanningGroup, look: Looking, rng: np.random.Generator) -> list[np.ndarray]:
    """Configurations of a random walk from rest on which nothing touches; they lead to what can be reached."""
    walk, legs = [group.part_of(robot.rest)], 0
    for share in np.repeat(np.linspace(0.6, 0.05, 12), 3):
        there = group.interpolate(walk[-1], group.random(rng), share)
        steps = 1 + int(np.abs(group.difference(walk[-1], there)).max() / APART)
        leg = [group.interpolate(walk[-1], there, t) for t in np.linspace(0.0, 1.0, steps + 1)[1:]]
        if not any(look.touches(values(robot, group, q)) for q in leg):
            walk += leg
            legs += 1
        if legs == 2:
            break
    return walk


def obstacles(
    robot: RobotModel, urdf: UrdfText, group: PlanningGroup, walk: list[np.ndarray], rng: np.random.Generator
) -> list[Sphere]:
    """Spheres near the robot that touch it nowhere on a walk, with some room."""
    look, found = Looking(robot, urdf, []), []
    near = np.concatenate([look.centres(values(robot, group, q)) for q in walk[:: max(1, len(walk) // 10)]])
    for _ in range(20):
        at = near[rng.integers(len(near))] + rng.normal(scale=0.2, size=3)
        sphere = Sphere(name=f"s{len(found)}", radius=RADIUS, position=tuple(at.tolist()))
        larger = Sphere(name="larger", radius=RADIUS + 0.02, position=sphere.position)
        around = Looking(robot, urdf, [larger])
        if not any(around.touches(values(robot, group, q)) for q in walk):
            found.append(sphere)
        if len(found) == 4:
            break
    return found


@pytest.mark.parametrize("count", SEEDS)
def test_robots_of_up_to_twenty_joints_are_planned_for(count: int) -> None:
    seed = SEEDS[count]
    assert planned_for(chain(random.Random(seed), count), seed)


@pytest.mark.parametrize("seed", range(2))
def test_robots_with_angles_whose_turns_count_are_planned_for(seed: int) -> None:
    assert planned_for(chain(random.Random(seed), 8, WOUND), seed)


@pytest.mark.parametrize("kinds", [KINDS, WOUND], ids=["of every kind", "with mimic joints"])
@pytest.mark.skipif(not EXAMPLES, reason="tools/random_chains draws as many as it is told")
@settings(THOROUGH, max_examples=EXAMPLES or 1)
@given(st.data())
def test_they_are_planned_for(kinds: tuple[str, ...], data: st.DataObject) -> None:
    urdf, seed = data.draw(chains(kinds=kinds)), data.draw(st.integers(0, 2**16))
    assume(planned_for(urdf, seed))


def planned_for(urdf: UrdfText, seed: int) -> bool:
    """Plan among spheres to the end of a free walk; Coal, which knows the URDF only, finds nothing that touches.

    False if the robot has no joint that moves, or touches itself at rest, so that there is nothing to plan.
    """
    robot = load(urdf)
    if not movable(robot):
        return False
    group = select(robot, movable(robot), None, robot.rest, pin.SE3.Identity())
    rng = np.random.default_rng(seed)
    alone = Looking(robot, urdf, [])
    if alone.touches(configuration_to_wire(robot.joints, robot.rest)):
        return False
    walk = free_walk(robot, group, alone, rng)
    spheres = obstacles(robot, urdf, group, walk, rng)
    reply = ENGINE.answer(
        PlanRequest(
            robot=urdf,
            scene=Scene(name="spheres", obstacles=list(spheres)),
            group=movable(robot),
            goal=JointsGoal(positions=configuration_to_wire(group.joints, walk[-1])),
            guide_planes=[],
            allowed_planning_time=60.0,
            sample_rate=DENSE,
            recording="off",
        )
    )
    assert reply.status.name == "SUCCESS", reply.status
    assert reply.certificate.collision_free
    look = Looking(robot, urdf, spheres)
    rows = [given_by(reply.position_names, row) for row in reply.trajectory.positions]
    assert not any(look.touches(row) for row in rows)
    for row, asked in ((rows[0], walk[0]), (rows[-1], walk[-1])):
        reached = group.part_of(configuration_from_wire(robot, row))
        assert np.abs(group.difference(reached, asked)).max() < 1e-6
    return True
