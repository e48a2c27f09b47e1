"""Planning scenes: what a message changes, as MoveIt's own rules have it."""

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from guidefield.endpoint.ros.collision_objects import object_of
from guidefield.endpoint.ros.refusals import Refused
from guidefield.endpoint.ros.services import GEOMETRY, MATRIX, OBJECT_NAMES, SETTINGS, scene_response
from guidefield.endpoint.ros.snapshot import (
    ADD,
    APPEND,
    MOVE,
    REMOVE,
    Snapshot,
    apply_joint_state,
    apply_scene,
    with_state,
)
from guidefield.errors import Status
from guidefield.messages.scene import Box, Cylinder, HalfSpace, Mesh, Sphere
from tests.endpoint.ros.messages import BENT, held, point, pose, primitive, scene, snapshot, state, thing
from tests.endpoint.ros.peer import TYPES, new

START = snapshot()
BOX = primitive(1, 0.1, 0.2, 0.3)
BALL = primitive(2, 0.05)
CAN = primitive(3, 0.3, 0.04)
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def after(*messages: Any, before: Snapshot = START) -> Snapshot:
    for message in messages:
        before = apply_scene(before, message)
    return before


def places(now: Snapshot) -> dict[str, tuple[float, ...]]:
    return {one.name: tuple(np.round(one.position, 9)) for one in now.scene().obstacles}


class TestObjects:
    def test_shapes_are_ours_with_their_sizes(self):
        mesh = new(
            "shape_msgs/msg/Mesh",
            vertices=[point(0, 0, 0), point(1, 0, 0), point(0, 1, 0), point(0, 0, 1)],
            triangles=[new("shape_msgs/msg/MeshTriangle", vertex_indices=[0, 2, 1])],
        )
        plane = new("shape_msgs/msg/Plane", coef=[0.0, 0.0, 2.0, 1.0])
        given = thing("a", [BOX, BALL, CAN], meshes=[mesh], planes=[plane])
        obstacles = after(scene(given)).scene().obstacles
        assert [type(one) for one in obstacles] == [Box, Sphere, Cylinder, Mesh, HalfSpace]
        assert [one.name for one in obstacles] == [f"a/{number}" for number in range(5)]
        assert obstacles[0].size == (0.1, 0.2, 0.3)
        assert (obstacles[2].length, obstacles[2].radius) == (0.3, 0.04)
        assert (obstacles[4].normal, obstacles[4].offset) == ((0.0, 0.0, 1.0), -0.5)

    def test_poses_are_in_the_objects_and_that_in_the_headers_frame(self):
        given = thing("a", [BOX, BOX], [pose(0.1, 0, 0), pose(0, 0.1, 0)], pose=pose(1, 2, 3, QUARTER))
        assert places(after(scene(given))) == {"a/0": (1.0, 2.1, 3.0), "a/1": (0.9, 2.0, 3.0)}
        on = thing("b", [BALL], [pose(0, 0, 0.5)], frame="a")
        assert places(after(scene(given, on)))["b"] == (1.0, 2.0, 3.5)
        link = START.link("panda_hand")
        at = after(scene(thing("c", [BALL], [pose(0, 0, 0.5)], frame="panda_hand")))
        assert places(at)["c"] == pytest.approx(link.act(np.array([0, 0, 0.5])), abs=1e-9)

    def test_a_plane_that_is_turned_and_moved(self):
        plane = new("shape_msgs/msg/Plane", coef=[1.0, 0.0, 0.0, 0.0])
        (floor,) = after(scene(thing("a", planes=[plane], pose=pose(1, 2, 3, QUARTER)))).scene().obstacles
        assert floor.normal == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
        assert floor.offset == pytest.approx(2.0)

    def test_a_single_shapes_pose_is_that_of_an_object_without_one(self):
        first = scene(thing("a", [BALL], [pose(1, 0, 0)]))
        assert places(after(first, scene(thing("a", operation=MOVE, pose=pose(0, 0, 2))))) == {"a": (0.0, 0.0, 2.0)}
        first = scene(thing("a", [BALL], [pose(1, 0, 0)], pose=pose(0, 1, 0)))
        assert places(after(first, scene(thing("a", operation=MOVE, pose=pose(0, 0, 2))))) == {"a": (1.0, 0.0, 2.0)}

    def test_adding_replaces_and_appending_appends(self):
        one, two = thing("a", [BALL], [pose(1, 0, 0)]), thing("a", [BOX], [pose(0, 1, 0)])
        assert places(after(scene(one), scene(two))) == {"a": (0.0, 1.0, 0.0)}
        two.operation = APPEND
        assert places(after(scene(one), scene(two))) == {"a/0": (1.0, 0.0, 0.0), "a/1": (0.0, 1.0, 0.0)}
        assert places(after(scene(two))) == {"a": (0.0, 1.0, 0.0)}

    def test_removing_one_or_all(self):
        both = scene(thing("a", [BALL]), thing("b", [BALL]))
        assert set(after(both, scene(thing("a", operation=REMOVE))).objects) == {"b"}
        assert set(after(both, scene(thing("", operation=REMOVE))).objects) == set()
        with pytest.raises(Refused, match=r"world\.collision_objects\[0\]\.id"):
            after(both, scene(thing("c", operation=REMOVE)))

    def test_a_quaternion_of_zeros_is_the_identity_and_any_length_counts(self):
        given = thing("a", [BOX], pose=pose(0, 0, 1, (0.0, 0.0, 0.0, 0.0)))
        assert after(scene(given)).scene().obstacles[0].quaternion_xyzw == (0.0, 0.0, 0.0, 1.0)
        given = thing("a", [BOX], pose=pose(0, 0, 1, (0.0, 0.0, 3.0, 3.0)))
        assert after(scene(given)).scene().obstacles[0].quaternion_xyzw == pytest.approx(QUARTER)

    @pytest.mark.parametrize(
        ("given", "field"),
        [
            (thing("a"), "has no primitives"),
            (thing("", [BALL]), r"collision_objects\[1\]\.id"),
            (thing("a", [BALL], frame="nowhere"), r"header\.frame_id"),
            (thing("a", [primitive(4, 0.1, 0.1)]), r"primitives\[0\]\.type"),
            (thing("a", [primitive(1, 0.1)]), r"primitives\[0\]\.dimensions"),
            (thing("a", [primitive(2, math.nan)]), r"dimensions\[0\]"),
            (thing("a", [BALL], [pose(math.inf, 0, 0)]), r"primitive_poses\[0\]\.position\.x"),
            (thing("a", [BALL], operation=MOVE), "is no object"),
            (thing("a", [BALL], operation=9), "operation"),
            (thing("a", [BALL], subframe_names=["x"]), "subframe_names"),
            (thing("a", planes=[new("shape_msgs/msg/Plane")]), r"planes\[0\]\.coef"),
            (thing("a", meshes=[new("shape_msgs/msg/Mesh")]), r"meshes\[0\]"),
        ],
    )
    def test_what_is_wrong_is_named_and_nothing_of_the_message_counts(self, given: Any, field: str):
        with pytest.raises(Refused, match=field):
            after(scene(thing("good", [BALL]), given))
        assert START.objects == {}

    @pytest.mark.parametrize(
        ("fields", "field"),
        [
            ({"fixed_frame_transforms": [new("geometry_msgs/msg/TransformStamped")]}, "fixed_frame_transforms"),
            ({"link_padding": [new("moveit_msgs/msg/LinkPadding", link_name="panda_hand", padding=0.1)]}, "padding"),
            ({"link_scale": [new("moveit_msgs/msg/LinkScale", link_name="panda_hand", scale=1.1)]}, "scale"),
        ],
    )
    def test_what_would_change_the_judgement_is_refused(self, fields: dict[str, Any], field: str):
        with pytest.raises(Refused, match=field):
            after(scene(**fields))
        message = scene()
        message.world.octomap.octomap.data = np.zeros(3, np.int8)
        with pytest.raises(Refused, match="octomap"):
            after(message)


class TestHeld:
    def test_an_object_of_the_scene_stays_where_it_is_when_it_is_taken_and_let_go(self):
        there = pose(*START.link("panda_hand").act(np.array([0, 0, 0.15])))
        take = state(attached=[held("panda_hand", thing("rod"), "panda_leftfinger")])
        let = state(attached=[held("panda_hand", thing("rod", operation=REMOVE))])
        taken = after(scene(thing("rod", [CAN], [there])), scene(robot_state=take))
        assert taken.objects == {}
        (one,) = taken.attached()
        assert (one.link, one.touch_links, one.obstacle.name) == ("panda_hand", ["panda_leftfinger"], "rod")
        assert one.placement.position == pytest.approx((0, 0, 0.15), abs=1e-9)
        moved = apply_joint_state(
            taken, new("sensor_msgs/msg/JointState", name=["panda_joint1", "nobody"], position=[1.0, 2.0])
        )
        let_go = after(scene(robot_state=let), before=moved)
        assert let_go.held == {}
        turn = pin.SE3(pin.utils.rotate("z", 1.0 - BENT["panda_joint1"]), np.zeros(3))
        expected = turn.act(START.link("panda_hand").act(np.array([0, 0, 0.15])))
        assert places(let_go)["rod"] == pytest.approx(expected, abs=1e-9)

    def test_a_state_that_is_no_diff_says_all_that_is_held(self):
        rod = held("panda_hand", thing("rod", [CAN], frame="panda_hand"))
        taken = with_state(START, state(attached=[rod]), "start_state")
        assert set(with_state(taken, state(), "start_state").held) == {"rod"}
        assert set(with_state(taken, state(diff=False), "start_state").held) == {"rod"}
        assert set(with_state(taken, state(BENT, diff=False), "start_state").held) == set()

    @pytest.mark.parametrize(
        ("attached", "field"),
        [
            (held("nobody", thing("rod", [CAN])), "link_name"),
            (held("panda_hand", thing("rod", [CAN]), "nobody"), "touch_links"),
            (held("panda_hand", thing("rod")), "has no shapes"),
            (held("panda_hand", thing("rod", operation=REMOVE)), "isn't held"),
            (held("panda_hand", thing("rod", operation=MOVE)), "operation"),
        ],
    )
    def test_what_is_wrong_is_named(self, attached: Any, field: str):
        with pytest.raises(Refused, match=rf"attached_collision_objects\[0\].*{field}"):
            with_state(START, state(attached=[attached]), "start_state")


class TestStates:
    def test_joints_that_are_left_out_keep_their_values(self):
        found = with_state(START, state({"panda_joint2": -0.1, "panda_finger_joint2": 0.03}), "start_state")
        assert found.whole == {**START.whole, "panda_joint2": -0.1}
        assert Snapshot(START.robot).whole == START.robot.rest

    @pytest.mark.parametrize("positions", [{"nobody": 0.0}, {"panda_joint1": math.nan}])
    def test_what_is_wrong_is_named(self, positions: dict[str, float]):
        with pytest.raises(Refused, match=r"start_state\.joint_state") as refused:
            with_state(START, state(positions), "start_state")
        assert refused.value.code == Status.INVALID_ROBOT_STATE

    def test_places_of_links_are_pinocchios(self):
        model = START.robot.model.model
        data, q = model.createData(), pin.neutral(model)
        for name, value in {**START.whole, "panda_finger_joint2": START.whole["panda_finger_joint1"]}.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        for link in START.robot.links:
            theirs = next(i for i, frame in enumerate(model.frames) if frame.name == link and frame.type == pin.BODY)
            assert START.link(link).isApprox(data.oMf[theirs], 1e-12)


class TestMatrix:
    def matrix(self, names: list[str], pairs: list[tuple[str, str]], defaults: dict[str, bool] | None = None) -> Any:
        rows = [[(a, b) in pairs or (b, a) in pairs for b in names] for a in names]
        return new(
            "moveit_msgs/msg/AllowedCollisionMatrix",
            entry_names=names,
            entry_values=[new("moveit_msgs/msg/AllowedCollisionEntry", enabled=row) for row in rows],
            default_entry_names=list(defaults or {}),
            default_entry_values=list((defaults or {}).values()),
        )

    def test_pairs_that_may_touch_of_all_shapes_of_an_object(self):
        matrix = self.matrix(["panda_hand", "a", "gone"], [("panda_hand", "a"), ("a", "gone")])
        now = after(scene(thing("a", [BALL, BOX])), scene(allowed_collision_matrix=matrix))
        assert sorted(map(sorted, now.allowed())) == [["a/0", "panda_hand"], ["a/1", "panda_hand"]]
        assert after(scene(), before=now).allowed() == now.allowed()

    def test_a_default_counts_where_there_is_no_entry(self):
        matrix = self.matrix(["panda_hand", "a"], [], {"a": True})
        now = after(scene(thing("a", [BALL])), scene(allowed_collision_matrix=matrix))
        links = {link for pair in now.allowed() for link in pair} - {"a"}
        assert links == set(START.robot.links) - {"panda_hand"}

    def test_a_matrix_that_is_not_square_is_refused(self):
        matrix = self.matrix(["a", "b"], [])
        matrix.entry_values.pop()
        with pytest.raises(Refused, match=r"allowed_collision_matrix\.entry_values"):
            after(scene(allowed_collision_matrix=matrix))


class TestTold:
    def told(self, now: Snapshot, components: int = 0) -> Any:
        name = "moveit_msgs/srv/GetPlanningScene_Response"
        return TYPES.read(TYPES.write(TYPES.new(name, **scene_response(now, components)), name), name).scene

    def test_what_is_told_and_applied_again_changes_nothing(self):
        rod = held("panda_hand", thing("rod", [CAN], frame="panda_hand"), "panda_leftfinger")
        mesh = new(
            "shape_msgs/msg/Mesh",
            vertices=[point(0, 0, 0), point(1, 0, 0), point(0, 1, 0)],
            triangles=[new("shape_msgs/msg/MeshTriangle", vertex_indices=[0, 2, 1])],
        )
        given = thing("a", [BOX, BALL], [pose(0.1, 0, 0), pose(0, 1, 0)], pose=pose(1, 2, 3, QUARTER), meshes=[mesh],
                      planes=[new("shape_msgs/msg/Plane", coef=[0.0, 0.0, 1.0, 0.2])])  # fmt: skip
        now = after(scene(given, thing("b", [BALL])), scene(robot_state=state(attached=[rod]), name="mine"))
        again = apply_scene(START, self.told(now))
        assert (again.name, again.whole) == ("mine", pytest.approx(now.whole))
        assert [one.name for one in again.scene().obstacles] == [one.name for one in now.scene().obstacles]
        assert places_of_all(again) == pytest.approx(places_of_all(now), abs=1e-9)
        assert [one.touch_links for one in again.attached()] == [["panda_leftfinger"]]
        left_out = {frozenset(pair.links) for pair in now.robot.model.pairs_left_out}
        assert {frozenset(pair) for pair in again.allowed()} == {pair for pair in left_out if len(pair) == 2}

    def test_only_what_is_asked_for(self):
        now = after(scene(thing("a", [BALL])))
        names = self.told(now, OBJECT_NAMES)
        assert [(one.id, len(one.primitives)) for one in names.world.collision_objects] == [("a", 0)]
        assert names.robot_state.joint_state.name == []
        assert len(self.told(now, GEOMETRY).world.collision_objects[0].primitives) == 1
        assert self.told(now, SETTINGS).robot_model_name == "panda"
        assert "a" in self.told(now, MATRIX).allowed_collision_matrix.entry_names


def places_of_all(now: Snapshot) -> list[float]:
    found = []
    for one in now.scene().obstacles:
        if isinstance(one, HalfSpace):
            found += [*one.normal, one.offset]
        else:
            found += [*one.position]
    return [*found, *(x for one in now.attached() for x in one.placement.position)]


def test_an_obstacle_is_a_shape_of_an_object():
    assert object_of("a", {"a"}) == "a"
    assert object_of("a/1", {"a"}) == "a"
    assert object_of("b/1", {"a"}) is None
    assert ADD == 0
