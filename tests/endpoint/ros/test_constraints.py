"""Constraints against MoveIt's own test of them, written again: whatever we allow, it allows."""

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.endpoint.ros.constraints import goal_of, path_constraints_of
from guidefield.endpoint.ros.refusals import FRAME_TRANSFORM_FAILURE, Refused
from guidefield.endpoint.ros.snapshot import apply_scene, with_state
from guidefield.errors import Status
from guidefield.messages.conditions import LineConstraint, OrientationCone, PlaneConstraint
from guidefield.messages.values import JointSetGoal, JointsGoal, PoseGoal
from tests.endpoint.ros.messages import (
    ARM,
    constraints,
    held,
    joint,
    offset,
    orientation,
    pose,
    position,
    primitive,
    scene,
    snapshot,
    state,
    thing,
    turned,
    within,
)

START = snapshot()
TIP = "panda_hand_tcp"
TOLERANCES = st.tuples(*[st.floats(0.005, 1.5)] * 3)
QUATERNIONS = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=4))
BOX, BALL, CYLINDER, CONE = 1, 2, 3, 4
BALL_THERE = primitive(BALL, 0.1)
BESIDE_BALL = position(TIP, BALL_THERE, pose(0.0, 0.0, 1.0), target_point_offset=offset(0.0, 0.0, 0.1))


def goal(*asked: Any) -> PoseGoal:
    found = goal_of(asked, ARM, START)
    return found.goal


def moveit_allows_turn(wanted: np.ndarray, turn: np.ndarray, tolerances: tuple[float, float, float], kind: int) -> bool:
    """As OrientationConstraint decides: the error's Euler angles x, y, z, or its rotation vector."""
    error = wanted.T @ turn
    if kind == 1:
        angles = np.abs(pin.log3(error))
    else:
        angles = np.abs([math.atan2(-error[1, 2], error[2, 2]), math.asin(np.clip(error[0, 2], -1, 1)),
                         math.atan2(-error[0, 1], error[0, 0])])  # fmt: skip
    return bool(np.all(angles <= np.array(tolerances) + 1e-9))


def matrix(quaternion: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return pin.Quaternion(w, x, y, z).toRotationMatrix()


def near(shape: Any, link: str = TIP) -> Any:
    return position(link, shape, pose(0.0, 0.0, 1.0))


def level(tolerances: tuple[float, float, float], kind: int = 0) -> Any:
    return orientation(TIP, turned(0.0, 0.0, 0.0, 1.0), tolerances, kind)


class TestJoints:
    def test_positions_are_the_goal(self):
        found = goal_of([constraints([joint("panda_joint1", 0.5), joint("panda_joint4", -1.0)])], ARM, START)
        assert found.goal == JointsGoal({"panda_joint1": 0.5, "panda_joint4": -1.0})
        assert (found.tip, found.notes) == (None, ())

    def test_several_are_a_set(self):
        asked = [constraints([joint("panda_joint1", value)]) for value in (0.5, -0.5)]
        assert goal_of(asked, ARM, START).goal == JointSetGoal([{"panda_joint1": 0.5}, {"panda_joint1": -0.5}])

    def test_beyond_a_limit_the_nearest_that_is_allowed_is_taken(self):
        upper = START.robot.limits("panda_joint1")[1]
        for below, noted in ((0.1, False), (0.001, True)):
            found = goal_of([constraints([joint("panda_joint1", upper + 0.01, 0.0, below)])], ARM, START)
            assert found.goal == JointsGoal({"panda_joint1": upper})
            assert bool(found.notes) is noted

    @pytest.mark.parametrize(
        ("asked", "field"),
        [
            (joint("nobody", 0.0), "joint_name"),
            (joint("panda_finger_joint1", 0.0), "joint_name"),
            (joint("panda_finger_joint2", 0.0), "joint_name"),
            (joint("panda_joint1", math.nan), "position"),
            (joint("panda_joint1", 0.0, above=-1.0), "tolerance_above"),
            (joint("panda_joint1", 0.0, below=math.inf), "tolerance_below"),
        ],
    )
    def test_what_is_wrong_is_named(self, asked: Any, field: str):
        with pytest.raises(Refused, match=rf"goal_constraints\[0\]\.joint_constraints\[0\]\.{field}") as refused:
            goal_of([constraints([asked])], ARM, START)
        assert refused.value.code == Status.INVALID_GOAL_CONSTRAINTS


class TestPoses:
    @settings(max_examples=18)
    @given(QUATERNIONS, TOLERANCES, st.booleans(), st.integers(0, 1), st.integers(0, 2**32 - 1))
    def test_every_rotation_that_the_goal_allows_moveit_allows(self, wanted, tolerances, free, kind, seed):
        if free:
            tolerances = (*tolerances[:2], 3.2)
        found = goal(constraints(orientations=[orientation(TIP, turned(*wanted), tolerances, kind)]))
        assert found.position_tolerance == (None, None, None)
        assert np.allclose(matrix(np.array(found.quaternion_xyzw)), matrix(wanted), atol=1e-9)
        rng, R_wanted = np.random.default_rng(seed), matrix(wanted)
        most = np.array([math.pi if t is None else t for t in found.orientation_tolerance])
        for _ in range(40):
            vector = rng.uniform(-1.0, 1.0, 3) * most
            vector[rng.integers(3)] *= rng.choice([1.0, 1.0 / max(abs(vector).max() / most.max(), 1e-9)])
            vector = np.clip(vector, -most, most)
            if np.linalg.norm(vector) >= math.pi:
                continue
            assert moveit_allows_turn(R_wanted, R_wanted @ pin.exp3(vector), tolerances, kind)

    @settings(max_examples=18)
    @given(
        QUATERNIONS,
        QUATERNIONS,
        st.sampled_from([(BOX, 0.2, 0.04, 0.1), (BALL, 0.05), (CYLINDER, 0.2, 0.03)]),
        st.integers(0, 2**32 - 1),
    )
    def test_every_place_that_the_goal_allows_is_in_the_region(self, region, wanted, shape, seed):
        at = pose(0.4, 0.1, 0.5, tuple(region))
        tip = [orientation(TIP, turned(*wanted), (0.1, 0.1, 0.1), 1)]
        for turns in ([], tip):
            found = goal(constraints(positions=[position(TIP, primitive(*shape), at)], orientations=turns))
            rng = np.random.default_rng(seed)
            half = np.array(found.position_tolerance)
            corners = rng.choice([-1.0, 1.0], (40, 3)) * half
            world = corners @ matrix(np.array(found.quaternion_xyzw)).T + found.position
            local = (world - [0.4, 0.1, 0.5]) @ matrix(region)
            assert np.all([_inside(shape, one) for one in local])

    @settings(max_examples=18)
    @given(
        QUATERNIONS,
        TOLERANCES,
        st.integers(0, 1),
        st.tuples(*[st.floats(-0.3, 0.3)] * 3),
        st.sampled_from([(BOX, 0.2, 0.04, 0.1), (BALL, 0.05), (CYLINDER, 0.2, 0.03)]),
        st.integers(0, 2**32 - 1),
    )
    def test_a_point_of_the_link_stays_in_the_region_however_the_goal_lets_it_turn(
        self,
        wanted: np.ndarray,
        tolerances: tuple[float, float, float],
        kind: int,
        lever: tuple[float, float, float],
        shape: tuple[int, ...],
        seed: int,
    ):
        at = pose(0.4, 0.1, 0.5, (0.1, 0.2, 0.3, 0.9))
        asked = position(TIP, primitive(*shape), at, target_point_offset=offset(*lever))
        found = goal(constraints([], [asked], [orientation(TIP, turned(*wanted), tolerances, kind)]))
        rng, R_region = np.random.default_rng(seed), matrix(np.array([0.1, 0.2, 0.3, 0.9]))
        R_goal = matrix(np.array(found.quaternion_xyzw))
        assert np.min(found.position_tolerance) > 0.0
        assert np.min(found.orientation_tolerance) > 0.0
        for _ in range(40):
            R_link = R_goal @ pin.exp3(rng.choice([-1.0, 1.0], 3) * found.orientation_tolerance)
            origin = found.position + R_goal @ (rng.choice([-1.0, 1.0], 3) * found.position_tolerance)
            local = R_region.T @ (origin + R_link @ lever - [0.4, 0.1, 0.5])
            assert _inside(shape, local)
            assert moveit_allows_turn(matrix(wanted), R_link, tolerances, kind)

    def test_an_offset_that_no_turning_spoils_is_only_a_shift(self):
        upright = [orientation(TIP, turned(0.0, 0.0, 0.0, 1.0), (1e-3, 1e-3, 1e-3), 1)]
        box, above = primitive(BOX, 0.2, 0.2, 0.2), offset(0.0, 0.0, 0.1)
        near_it = position(TIP, box, pose(0.4, 0.1, 0.5), target_point_offset=above)
        found = goal(constraints([], [near_it], upright))
        assert found.position == pytest.approx((0.4, 0.1, 0.4))
        assert found.orientation_tolerance == pytest.approx((1e-3, 1e-3, 1e-3))
        assert found.position_tolerance == pytest.approx(np.full(3, 0.1 - 0.1 * math.sqrt(3.0) * 1e-3), abs=1e-9)

    def test_each_region_is_a_goal_of_its_own(self):
        shapes, poses = [primitive(BALL, 0.1), primitive(BOX, 0.2, 0.1, 0.3)], [pose(0.4, 0, 0.5), pose(0, 0.4, 0.5)]
        for turns in ([], [level((0.1, 0.1, 0.1))]):
            found = goal_of([constraints([], [within(TIP, shapes, poses)], turns)], ARM, START)
            ones = [goal(constraints([], [position(TIP, *one)], turns)) for one in zip(shapes, poses, strict=True)]
            assert [found.goal, *(other.goal for other in found.others)] == ones
            assert {found.tip, *(other.tip for other in found.others)} == {TIP}
        joints = constraints([joint("panda_joint1", 0.3)])
        found = goal_of([constraints(positions=[near(primitive(BALL, 0.1))]), joints], ARM, START)
        assert [other.goal for other in found.others] == [JointsGoal({"panda_joint1": 0.3})]

    def test_a_box_with_the_goals_axes_is_taken_whole(self):
        at = pose(0.4, 0.1, 0.5)
        found = goal(constraints(positions=[position(TIP, primitive(BOX, 0.2, 0.04, 0.1), at)]))
        assert found.position_tolerance == pytest.approx((0.1, 0.02, 0.05))
        assert found.orientation_tolerance == (None, None, None)
        quarter = turned(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
        turns = [orientation(TIP, quarter, (0.1, 0.2, 0.3), 1)]
        found = goal(constraints([], [position(TIP, primitive(BOX, 0.2, 0.04, 0.1), at)], turns))
        assert found.position_tolerance == pytest.approx((0.02, 0.1, 0.05))
        assert found.orientation_tolerance == pytest.approx((0.1, 0.2, 0.3))

    def test_frames_that_stand_still_count_and_those_that_move_are_refused(self):
        asked = position(TIP, primitive(BALL, 0.01), pose(0.4, 0.0, 0.5), frame="panda_link0")
        assert goal(constraints(positions=[asked])).position == pytest.approx((0.4, 0.0, 0.5))
        with_box = updated_with_box()
        asked = position(TIP, primitive(BALL, 0.01), pose(0.0, 0.0, 0.1), frame="box")
        found = goal_of([constraints(positions=[asked])], ARM, with_box).goal
        assert found.position == pytest.approx((0.5, 0.2, 0.4))
        for frame in ("panda_hand", "nowhere"):
            asked = position(TIP, primitive(BALL, 0.01), pose(0.4, 0.0, 0.5), frame=frame)
            with pytest.raises(Refused, match=r"header\.frame_id") as refused:
                goal(constraints(positions=[asked]))
            assert refused.value.code == FRAME_TRANSFORM_FAILURE

    @pytest.mark.parametrize(
        ("asked", "field"),
        [
            ((), "`goal_constraints` is empty"),
            ((constraints(),), "has no constraints"),
            ((constraints([joint("panda_joint1", 0.0)], [near(primitive(BALL, 0.1))]),), "either"),
            ((constraints(positions=[near(primitive(CONE, 0.1, 0.1))]),), r"primitives\[0\]\.type"),
            ((constraints(positions=[near(primitive(BALL, -0.1))]),), "dimensions"),
            ((constraints(positions=[near(primitive(BOX, 0.1))]),), "dimensions"),
            ((constraints(positions=[near(primitive(BALL, 0.1), "nobody")]),), "link_name"),
            ((constraints(orientations=[level((0.1, -0.1, 0.1))]),), "y_axis_tolerance"),
            ((constraints(orientations=[level((0.1, 0.1, 0.1), 7)]),), "parameterization"),
            ((constraints(orientations=[orientation(TIP, turned(0, 0, math.nan, 1), (1, 1, 1))]),), r"orientation\.z"),
            ((constraints(views=[None]),), "visibility_constraints"),
            ((constraints(positions=[within(TIP, [], [])]),), "primitive_poses"),
            ((constraints(positions=[within(TIP, [primitive(BALL, 0.1)], [])]),), "as many `primitive_poses`"),
            ((constraints(positions=[within(TIP, [primitive(BALL, 0.1)] * 65, [pose(0, 0, 1)] * 65)]),), "at most 64"),
            ((constraints(positions=[within(TIP, [BALL_THERE, primitive(CONE, 1, 1)], [pose(0, 0, 1)] * 2)]),),
             r"primitives\[1\]\.type"),
            ((constraints(positions=[BESIDE_BALL]),), "target_point_offset"),
            ((constraints([], [BESIDE_BALL], [level((0.1, 0.1, 4.0))]),), "bounds all three angles"),
        ],
    )  # fmt: skip
    def test_what_is_not_served_is_named(self, asked: Any, field: str):
        with pytest.raises(Refused, match=field):
            goal_of(asked, ARM, START)


class TestPaths:
    def kept(self, *asked: Any) -> list[Any]:
        return path_constraints_of(*asked, ARM, START)

    @settings(max_examples=18)
    @given(QUATERNIONS, TOLERANCES, st.booleans(), st.integers(0, 2**32 - 1))
    def test_every_rotation_within_the_cones_moveit_allows(self, wanted, tolerances, free, seed):
        if free:
            tolerances = (*tolerances[:2], 3.2)
        found = self.kept(constraints(orientations=[orientation(TIP, turned(*wanted), tolerances)]))
        assert len(found) == (1 if free else 2)
        rng, R_wanted, met = np.random.default_rng(seed), matrix(wanted), 0
        for _ in range(200):
            about = rng.uniform(-math.pi, math.pi) if free else 0.0
            turn = R_wanted @ pin.exp3(rng.normal(size=3) * min(tolerances) * 0.4) @ pin.utils.rotate("z", about)
            if all(_in_cone(cone, turn) for cone in found):
                met += 1
                assert moveit_allows_turn(R_wanted, turn, tolerances, 0)
        assert met > 0

    @pytest.mark.parametrize("shape", [(BOX, 0.4, 0.02, 0.1), (BALL, 0.1), (CYLINDER, 0.4, 0.05)])
    def test_every_place_between_the_planes_is_in_the_region(self, shape: tuple[int, ...]):
        wanted = np.array([0.3, -0.2, 0.5, 0.8])
        at = pose(0.4, 0.1, 0.5, tuple(wanted))
        found = self.kept(constraints(positions=[position(TIP, primitive(*shape), at)]))
        rng, inside = np.random.default_rng(1), 0
        middle = np.array([0.4, 0.1, 0.5])
        points = rng.uniform(-0.3, 0.3, (4000, 3)) + middle
        local = (points - middle) @ matrix(wanted)
        for there, own in zip(points, local, strict=True):
            if all(_keeps(one, there) for one in found):
                inside += 1
                assert _inside(shape, own)
        exact = sum(_inside(shape, own) for own in local)
        assert inside == exact if shape[0] != BALL else 0 < inside < exact

    @pytest.mark.parametrize(
        ("asked", "field"),
        [
            (within(TIP, [primitive(BALL, 0.1)] * 2, [pose(0, 0, 1)] * 2), "one region is served, got 2"),
            (position(TIP, primitive(BALL, 0.1), pose(0, 0, 1), target_point_offset=offset(0, 0, 1)), "along the path"),
        ],
    )
    def test_what_only_goals_may_have_is_named(self, asked: Any, field: str):
        with pytest.raises(Refused, match=field):
            self.kept(constraints(positions=[asked]))

    def test_a_joint_that_keeps_its_limits_anyway_is_no_constraint(self):
        assert self.kept(constraints([joint("panda_joint1", 0.0, 4.0, 4.0)])) == []
        with pytest.raises(Refused, match=r"path_constraints\.joint_constraints\[0\]"):
            self.kept(constraints([joint("panda_joint1", 0.0, 1.0, 4.0)]))

    def test_angles_that_are_all_free_are_no_constraint(self):
        assert self.kept(constraints(orientations=[orientation(TIP, turned(0, 0, 0, 1), (4, 4, 4))])) == []

    @pytest.mark.parametrize("tolerances", [(4.0, 0.1, 0.1), (0.0, 0.1, 4.0), (0.0, 0.1, 0.1)])
    def test_what_has_no_counterpart_is_refused(self, tolerances: tuple[float, float, float]):
        with pytest.raises(Refused, match=r"path_constraints\.orientation_constraints\[0\]"):
            self.kept(constraints(orientations=[orientation(TIP, turned(0, 0, 0, 1), tolerances)]))


def updated_with_box() -> Any:
    return apply_scene(START, scene(thing("box", [primitive(BOX, 0.1, 0.1, 0.1)], [pose(0.5, 0.2, 0.3)])))


def _inside(shape: tuple[float, ...], local: np.ndarray) -> bool:
    kind, *sizes = shape
    if kind == BOX:
        return bool(np.all(np.abs(local) <= np.array(sizes) / 2 + 1e-9))
    if kind == BALL:
        return bool(np.linalg.norm(local) <= sizes[0] + 1e-9)
    return bool(abs(local[2]) <= sizes[0] / 2 + 1e-9 and np.hypot(*local[:2]) <= sizes[1] + 1e-9)


def _keeps(one: PlaneConstraint | LineConstraint, there: np.ndarray) -> bool:
    away = there - one.point
    if isinstance(one, PlaneConstraint):
        return bool(abs(away @ one.normal) <= one.tolerance)
    return bool(np.linalg.norm(np.cross(away, one.direction)) <= one.tolerance)


def _in_cone(cone: OrientationCone, turn: np.ndarray) -> bool:
    cosine = float((turn @ cone.axis) @ cone.target_axis)
    return math.acos(np.clip(cosine, -1.0, 1.0)) <= cone.half_angle


def test_a_held_frame_moves_with_the_link_that_holds_it():
    rod = held("panda_hand", thing("rod", [primitive(BOX, 0.02, 0.02, 0.2)], [pose(0, 0, 0.1)], frame="panda_hand"))
    holding = with_state(START, state(attached=[rod]), "start_state")
    asked = position(TIP, primitive(BALL, 0.01), pose(0.0, 0.0, 0.0), frame="rod")
    with pytest.raises(Refused, match="moves with the group"):
        goal_of([constraints(positions=[asked])], ARM, holding)
