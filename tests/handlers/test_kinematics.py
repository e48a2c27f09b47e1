"""The kinematics requests, on arms and scenes whose answers are known in closed form."""

import math

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.errors import (
    InvalidConfiguration,
    InvalidGroup,
    Status,
    UnknownFrame,
    UnknownObject,
)
from guidefield.handlers.configurations import CONFIGURATIONS_PER_CHECK
from guidefield.handlers.expired import ended_work
from guidefield.handlers.kinematics import (
    FRAMES_PER_CHECK,
    POINTS_PER_CHECK,
    answer_kinematics,
    clearance,
    forward_kinematics,
    inverse_kinematics,
    potential,
)
from guidefield.kernels.field.field import exact, field_at_points
from guidefield.messages import requests
from guidefield.messages.requests import TargetPose, UrdfText
from guidefield.messages.scene import Scene as SceneMessage, Sphere
from guidefield.messages.values import Placement, Reply
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.scene import scene as scenes
from tests.robots import box_arm, load, robot

LENGTH = 0.3
ARM = box_arm("y", 3, size=LENGTH)
PANDA = {"panda_joint1": 0.3, "panda_joint2": 0.2, "panda_joint4": -1.8, "panda_joint6": 2.1}
BASE = Placement((1.0, -2.0, 0.5), (0.0, 0.0, math.sin(0.4), math.cos(0.4)))
DOWN = (1.0, 0.0, 0.0, 0.0)


def built(*obstacles: Sphere) -> scenes.Scene:
    return scenes.build(SceneMessage("test", obstacles=list(obstacles)))


def ball(x: float, z: float, radius: float = 0.02, name: str = "ball") -> Sphere:
    return Sphere(name=name, radius=radius, position=(x, 0.0, z))


def elbow(*angles: float) -> tuple[float, float, float]:
    """End of a planar chain of links of one length that starts at the height of one link."""
    sums = np.cumsum(angles)
    return (float(LENGTH * np.sin(sums).sum()), 0.0, float(LENGTH * (1.0 + np.cos(sums).sum())))


def about_y(angle: float) -> tuple[float, float, float, float]:
    return (0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2))


def matrix(placement: Placement) -> np.ndarray:
    return pin.XYZQUATToSE3(np.array([*placement.position, *placement.quaternion_xyzw])).homogeneous


class TestForwardKinematics:
    def test_frames_and_configurations_come_in_the_order_asked(self):
        request = requests.ForwardKinematics(
            robot=ARM, frames=["l3", "l1"], configurations=[{"j1": 0.4, "j2": 1.1}, {"j1": -0.2}]
        )
        reply = forward_kinematics(request, load(ARM))
        for row, angles in zip(reply.placements, ([0.4, 1.1], [-0.2, 0.0]), strict=True):
            assert row[0].position == pytest.approx(elbow(*angles))
            assert row[1].position == pytest.approx((0.0, 0.0, LENGTH))
            assert np.abs(np.dot(row[0].quaternion_xyzw, about_y(sum(angles)))) == pytest.approx(1.0)
            assert np.abs(np.dot(row[1].quaternion_xyzw, about_y(angles[0]))) == pytest.approx(1.0)

    def test_the_placement_of_the_robot_moves_every_frame_alike(self):
        frames = ["panda_link0", "panda_link5", "panda_hand_tcp", "panda_leftfinger"]
        still = requests.ForwardKinematics(robot="panda", frames=frames, configurations=[PANDA])
        moved = requests.ForwardKinematics(robot="panda", frames=frames, configurations=[PANDA], robot_placement=BASE)
        here, there = (forward_kinematics(request, robot("panda")).placements[0] for request in (still, moved))
        for one, other in zip(here, there, strict=True):
            assert matrix(BASE) @ matrix(one) == pytest.approx(matrix(other), abs=1e-12)

    def test_what_is_unknown_is_named(self):
        panda = robot("panda")
        with pytest.raises(UnknownFrame, match="no frame 'tool9'"):
            forward_kinematics(requests.ForwardKinematics("panda", ["tool9"], [{}]), panda)
        with pytest.raises(InvalidConfiguration, match="no joint 'elbow'"):
            forward_kinematics(requests.ForwardKinematics("panda", ["panda_link5"], [{"elbow": 1.0}]), panda)


class TestInverseKinematics:
    POSE = TargetPose(elbow(0.4, 1.1), about_y(1.2))
    SOLUTIONS = ({"j1": 0.4, "j2": 1.1, "j3": -0.3}, {"j1": 1.5, "j2": -1.1, "j3": 0.8})

    def answer(self, **options):
        request = requests.InverseKinematics(robot=ARM, **{"poses": [self.POSE], **options})
        return lambda *obstacles: inverse_kinematics(request, load(ARM), built(*obstacles))

    def test_solutions_lead_back_to_the_pose(self):
        poses = [
            TargetPose((0.4, 0.1, 0.5), DOWN),
            TargetPose((5.0, 0.0, 0.0), DOWN),
            TargetPose((0.3, -0.4, 0.4), DOWN),
        ]
        reply = inverse_kinematics(
            requests.InverseKinematics("panda", poses, robot_placement=BASE, solutions=3), robot("panda"), None
        )
        assert [len(configurations) for configurations in reply.configurations] == [0, 0, 0]
        assert all(reason.startswith("out of reach") for reason in reply.reasons)
        reply = inverse_kinematics(requests.InverseKinematics("panda", poses, solutions=3), robot("panda"), None)
        assert [len(configurations) for configurations in reply.configurations] == [3, 0, 3]
        assert [bool(reason) for reason in reply.reasons] == [False, True, False]
        for pose, configurations in zip(poses, reply.configurations, strict=True):
            back = forward_kinematics(
                requests.ForwardKinematics("panda", ["panda_hand_tcp"], configurations), robot("panda")
            )
            for (tip,) in back.placements:
                assert tip.position == pytest.approx(pose.position, abs=1e-6)
                assert abs(np.dot(tip.quaternion_xyzw, pose.quaternion_xyzw)) == pytest.approx(1.0, abs=1e-12)

    def test_solutions_name_the_planned_joints_alone(self):
        reply = inverse_kinematics(
            requests.InverseKinematics("panda", [TargetPose((0.4, 0.1, 0.5), DOWN)]), robot("panda"), None
        )
        for configuration in reply.configurations[0]:
            assert list(configuration) == [f"panda_joint{i}" for i in range(1, 8)]

    def test_only_what_is_free_of_collision_is_a_solution(self):
        middles = [np.add(elbow(angle), (0.0, 0.0, LENGTH)) / 2 for angle in (0.4, 1.5)]  # of the first moving link
        blocks = [ball(x, z, name=name) for (x, _, z), name in zip(middles, ("high", "low"), strict=True)]
        for blocked, left in (((), [0, 1]), (blocks[:1], [1]), (blocks[1:], [0])):
            reply = self.answer(collision_free=True)(*blocked)
            found = sorted(reply.configurations[0], key=lambda positions: positions["j1"])
            assert [pytest.approx(self.SOLUTIONS[i], abs=1e-5) for i in left] == found
        assert self.answer(collision_free=True)(*blocks).reasons == [
            "2 distinct solutions from 256 starts, all in collision:"
            " most often l1 and high, 1 of 2 times (and 1 more pair)"
        ]
        assert len(self.answer()(*blocks).configurations[0]) == 2

    def test_what_is_held_must_be_free_too_unless_it_may_touch(self):
        held = requests.AttachedObject(Sphere(name="rod", radius=0.02), "l2", Placement((0.15, 0.0, 0.0)))
        request = requests.ForwardKinematics(ARM, ["l2"], [self.SOLUTIONS[0]])
        x, _, z = (matrix(forward_kinematics(request, load(ARM)).placements[0][0]) @ [0.15, 0.0, 0.0, 1.0])[:3]
        ends = self.answer(collision_free=True, attached_objects=[held])(ball(x, z)).configurations[0]
        assert [one["j1"] for one in ends] == [pytest.approx(self.SOLUTIONS[1]["j1"], abs=1e-5)]
        for options in ({}, {"attached_objects": [held], "allowed_collisions": [("rod", "ball")]}):
            assert len(self.answer(collision_free=True, **options)(ball(x, z)).configurations[0]) == 2
        with pytest.raises(UnknownObject, match="'nothing'"):
            self.answer(collision_free=True, allowed_collisions=[("l1", "nothing")])(ball(x, z))

    def test_without_a_scene_the_robot_still_has_to_keep_off_itself(self):
        snail = box_arm("y", 4, size=LENGTH)
        folded = {"j1": 0.0, "j2": 1.99, "j3": 1.99}
        for turn, reason in (
            (1.0, "1 distinct solution from 257 starts, all in collision: l0 and l4 (and 1 more pair)"),
            (-1.0, None),
        ):
            request = requests.InverseKinematics(
                snail,
                [TargetPose(elbow(0.0, 1.99, 1.99), about_y(2 * 1.99 + turn))],
                group=["j4"],
                collision_free=True,
                start_configurations=[folded],
            )
            reply = inverse_kinematics(request, load(snail), None)
            if reason is None:
                assert reply.configurations == [[{"j4": pytest.approx(turn, abs=1e-5)}]]
            else:
                assert (reply.configurations, reply.reasons) == ([[]], [reason])

    def test_a_start_configuration_comes_first(self):
        for start in self.SOLUTIONS:
            reply = self.answer(start_configurations=[start])()
            assert reply.configurations[0][0] == pytest.approx(start, abs=1e-9)

    def test_joints_outside_the_group_stay_where_the_first_start_has_them(self):
        pose = TargetPose(elbow(0.7, 0.9), about_y(0.0), orientation_tolerance=(None, None, None))
        options = {"poses": [pose], "group": ["j2", "j3"], "start_configurations": [{"j1": 0.7}]}
        reply = self.answer(**options)()
        assert reply.configurations[0]
        for configuration in reply.configurations[0]:
            assert set(configuration) == {"j2", "j3"}
            assert configuration["j2"] == pytest.approx(0.9, abs=1e-5)
        options["start_configurations"] = [{"j1": 0.7}, {"j1": 0.8}]
        with pytest.raises(InvalidConfiguration, match="j1"):
            self.answer(**options)()

    def test_each_pose_has_its_own_randomness(self):
        first = self.answer()().configurations[0]
        both = self.answer(poses=[self.POSE, TargetPose((9.0, 0.0, 0.0), DOWN)])().configurations
        assert both[0] == first

    def test_what_cannot_be_asked_is_named(self):
        with pytest.raises(InvalidGroup, match="j9"):
            self.answer(group=["j9"])()
        with pytest.raises(UnknownFrame, match="tool9"):
            self.answer(tip="tool9")()


class TestClearance:
    def answer(self, configurations, *obstacles):
        return clearance(requests.Clearance(ARM, "test", configurations), load(ARM), built(*obstacles))

    def test_a_ball_beside_an_upright_arm(self):
        reply = self.answer([{}, {"j2": math.pi / 2, "j1": 0.0}], ball(0.5, 0.45, radius=0.1))
        assert reply.minimum[0] == pytest.approx(0.5 - 0.1 - 0.02, abs=1e-6)
        assert reply.pair[0] == ["l1", "ball"]
        assert reply.witness_points[0][0] == pytest.approx((0.02, 0.0, 0.45), abs=1e-5)
        assert reply.witness_points[0][1] == pytest.approx((0.4, 0.0, 0.45), abs=1e-5)
        # l2 lies along x at z = 0.6, from 0.015 to 0.285; l3 from 0.315 to 0.585: above the ball
        assert reply.minimum[1] == pytest.approx(0.6 - 0.02 - 0.55, abs=1e-6)
        assert reply.pair[1] == ["l3", "ball"]

    def test_in_contact_it_is_negative_by_the_depth(self):
        reply = self.answer([{}], ball(0.1, 0.45, radius=0.1))
        assert reply.minimum[0] == pytest.approx(-0.02, abs=1e-6)

    def test_the_base_stands_on_the_floor(self):
        assert self.answer([{}], ball(0.0, 0.0, radius=0.1)).pair[0] == ["l1", "ball"]

    def test_without_obstacles_there_is_none(self):
        reply = self.answer([{}])
        assert (reply.minimum, reply.pair, reply.witness_points) == ([None], [None], [None])
        assert reply.self_minimum[0] is None or reply.self_minimum[0] > 0.0

    def test_contacts_are_told_where_they_are_asked_for(self):
        near = ball(0.1, 0.45, radius=0.1)
        assert self.answer([{}], near).contacts is None
        request = requests.Clearance(ARM, "test", [{}, {"j1": -1.5}], contacts=True)
        assert clearance(request, load(ARM), built(near)).contacts == [[["l1", "ball"]], []]
        held = requests.AttachedObject(Sphere(name="rod", radius=0.05), "l3", Placement((0.2, 0.0, 0.0)))
        far = ball(0.2, LENGTH * 3, radius=0.01)
        request = requests.Clearance(ARM, "test", [{}], attached_objects=[held], contacts=True)
        reply = clearance(request, load(ARM), built(far))
        assert reply.contacts == [[["rod", "ball"]]]
        assert reply.pair == [["rod", "ball"]]
        request = msgspec.structs.replace(request, allowed_collisions=[("ball", "rod")])
        assert clearance(request, load(ARM), built(far)).contacts == [[]]

    def test_every_joint_counts_also_outside_the_default_group(self):
        panda, opened = robot("panda"), {**PANDA, "panda_finger_joint1": 0.04}
        request = requests.ForwardKinematics("panda", ["panda_leftfinger"], [opened])
        finger = matrix(forward_kinematics(request, panda).placements[0][0])
        beside = Sphere(name="ball", radius=0.01, position=tuple((finger @ [0.0, 0.05, 0.045, 1.0])[:3]))
        reply = clearance(requests.Clearance("panda", "test", [opened, PANDA]), panda, built(beside))
        assert reply.pair[0] == ["panda_leftfinger", "ball"]
        assert reply.minimum[1] > reply.minimum[0] + 0.001

    def test_the_least_of_all_pairs_by_brute_force(self):
        panda = robot("panda")
        q = configuration_from_wire(panda, PANDA)
        model, geometry = panda.model, panda.geometry.copy()
        moving = [i for i, shape in enumerate(geometry.geometryObjects) if shape.parentJoint]
        place = np.array([0.5, 0.3, 0.4])
        added = geometry.addGeometryObject(pin.GeometryObject("ball", 0, pin.SE3(np.eye(3), place), coal.Sphere(0.05)))
        own = len(geometry.collisionPairs)
        for body in moving:
            geometry.addCollisionPair(pin.CollisionPair(body, added))
        data, geometry_data = model.createData(), geometry.createData()
        pin.computeDistances(model, data, geometry, geometry_data, q)
        distances = [result.min_distance for result in geometry_data.distanceResults]
        reply = clearance(
            requests.Clearance("panda", "test", [PANDA]),
            panda,
            built(Sphere(name="ball", radius=0.05, position=tuple(place))),
        )
        assert reply.minimum[0] == pytest.approx(min(distances[own:]), abs=1e-6)
        assert reply.self_minimum[0] == pytest.approx(min(distances[:own]), abs=1e-6)


class TestPotential:
    SCENE = (ball(0.5, 0.5, radius=0.1), ball(-0.6, 0.2, radius=0.15, name="other"))

    def at(self, points):
        request = requests.Potential(scene="test", points=points)
        return potential(request, None, built(*self.SCENE))

    def test_at_points_it_is_that_of_charged_balls(self):
        points = [(0.0, 0.0, 0.5), (0.5, 0.3, 0.5), (-0.6, 0.1, 0.9)]
        reply = self.at(points)
        for point, value, gradient in zip(points, reply.potential, reply.gradient, strict=True):
            expected, slope = 0.0, np.zeros(3)
            for sphere in self.SCENE:
                arm = np.array(point) - sphere.position
                R, a = float(np.linalg.norm(arm)), sphere.radius
                expected += 4.0 * math.pi * a**2 / (R * (R**2 - a**2))
                slope -= 4.0 * math.pi * a**2 * (3 * R**2 - a**2) / (R * (R**2 - a**2)) ** 2 * arm / R
            assert value == pytest.approx(expected, rel=1e-9)
            assert gradient == pytest.approx(tuple(slope), rel=1e-9)
        assert reply.winding == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)

    def test_the_generalized_force_is_minus_the_slope_of_the_potential(self):
        h, here = 1e-6, {"j1": 0.2, "j2": 0.4, "j3": -0.5}
        around = [{**here, joint: here[joint] + sign * h} for joint in here for sign in (1, -1)]
        request = requests.Potential(scene="test", robot=ARM, configurations=[here, *around])
        reply = potential(request, load(ARM), built(*self.SCENE))
        assert reply.velocity_names == ["j1", "j2", "j3"]
        forward, backward = np.array(reply.potential[1::2]), np.array(reply.potential[2::2])
        slope = (forward - backward) / (2 * h)
        assert reply.generalized_force[0] == pytest.approx(-slope, rel=1e-5, abs=1e-7)

    def test_the_wrenches_do_the_work_of_the_generalized_force(self):
        here = {"j1": 0.2, "j2": 0.4, "j3": -0.5}
        reply = potential(
            requests.Potential(scene="test", robot=ARM, configurations=[{}, here]), load(ARM), built(*self.SCENE)
        )
        origins = [np.array(elbow(*angles)) for angles in ([0.2, 0.4][:0], [0.2], [0.2, 0.4])]
        for joint in range(3):
            moment = np.zeros(3)
            for link in range(joint, 3):
                wrench = reply.links[f"l{link + 1}"]
                assert len(wrench.force) == len(wrench.torque) == 2
                moment += wrench.torque[1] + np.cross(origins[link] - origins[joint], wrench.force[1])
            assert moment[1] == pytest.approx(reply.generalized_force[1][joint], rel=1e-9, abs=1e-9)

    def test_joints_of_several_freedoms_have_a_column_for_each(self):
        floating: UrdfText = box_arm("y floating", 2)
        request = requests.Potential(scene="test", robot=floating, configurations=[{}])
        reply = potential(request, load(floating), built(*self.SCENE))
        assert reply.velocity_names == ["j1", *(f"j2.{c}" for c in ("vx", "vy", "vz", "wx", "wy", "wz"))]
        assert len(reply.generalized_force[0]) == 7


class TestAllowance:
    """However it ends, it ends between two of what was asked, and says how many were answered."""

    FRAMES = requests.ForwardKinematics(robot=ARM, frames=["l3"], configurations=[{}] * (9 * FRAMES_PER_CHECK))
    REACHES = requests.InverseKinematics(robot=ARM, poses=[TargetPose(elbow(0.4, 0.3, 0.2), about_y(0.9))] * 9)
    NEAR = requests.Clearance(robot=ARM, scene="test", configurations=[{}] * (9 * CONFIGURATIONS_PER_CHECK))
    TWISTS = requests.Jacobian(robot=ARM, frames=["l3"], configurations=[{}] * (9 * CONFIGURATIONS_PER_CHECK))
    FIELD = requests.Potential(scene="test", robot=ARM, configurations=[{}] * 9)

    @staticmethod
    def answered(request: requests.KinematicsRequest, deadline: Deadline) -> Reply:
        robot_ = None if request.robot is None else load(request.robot)
        return answer_kinematics(request, robot_, built(ball(0.5, 0.5)), deadline)

    @pytest.mark.parametrize(
        "request_", [FRAMES, REACHES, NEAR, FIELD, TWISTS], ids=lambda request: type(request).__name__
    )
    def test_a_cancel_is_heard_before_the_next(self, request_: requests.KinematicsRequest):
        asked = 0

        def cancelled() -> bool:
            nonlocal asked
            asked += 1
            return asked > 4

        with pytest.raises(DeadlineExpired, match=r"^\d+ of \d+$") as ended:
            self.answered(request_, Deadline(is_cancelled=cancelled))
        assert ended.value.status is Status.PREEMPTED
        assert 9 * ended.value.details["done"] <= 4 * ended.value.details["of"]

    @pytest.mark.parametrize(
        "request_", [FRAMES, REACHES, NEAR, FIELD, TWISTS], ids=lambda request: type(request).__name__
    )
    def test_time_that_is_up_is_told(self, request_: requests.KinematicsRequest):
        with pytest.raises(DeadlineExpired, match=r"^0 of") as late:
            self.answered(request_, Deadline(0.0))
        told = ended_work(late.value, 2.5)
        assert told.message.startswith("the 2.5 s that `allowed_time` allows were up after 0 of")
        assert told.details["done"] == 0

    def test_the_field_at_many_points_is_that_at_each_and_ends_between_some(self):
        points = np.random.default_rng(0).uniform(-1.0, 1.0, (2 * POINTS_PER_CHECK + 37, 3))
        request = requests.Potential(scene="test", points=[tuple(point) for point in points.tolist()])
        reply = self.answered(request, Deadline())
        scene = built(ball(0.5, 0.5))
        at_once = field_at_points(exact(scene.tables), points)
        assert reply.potential == at_once.potential.tolist()
        assert np.array_equal(reply.gradient, at_once.gradient)
        assert reply.winding == at_once.winding.tolist()
        some = iter([False, False])
        with pytest.raises(DeadlineExpired, match=f"^{2 * POINTS_PER_CHECK} of {len(points)}$") as ended:
            self.answered(request, Deadline(is_cancelled=lambda: next(some, True)))
        told = ended_work(ended.value, 1.0)
        assert f"cancelled after {2 * POINTS_PER_CHECK} of" in told.message
