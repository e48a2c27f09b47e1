"""What is odd about a stream's requests is refused by name, or told: nothing is taken in silence."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield import Piece, Stream
from guidefield.errors import InvalidGoal, MalformedRequest, SceneInvalid, StreamUnknown, UnknownObject
from guidefield.stream.dodging import TimedPath

GOAL = {"type": "joints", "positions": {"shoulder_pan_joint": 0.9, "elbow_joint": 1.0}}
START = {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5}
HALF_SPACE = {
    "obstacle": {"type": "half_space", "name": "wall", "normal": [0, 0, 1], "offset": -0.5},
    "largest_speed": 0.1,
}
BALL = {"type": "sphere", "name": "ball", "radius": 0.3, "position": [0.0, 0.0, 0.6]}


def crate(speed: float = 0.2, name: str = "crate") -> dict[str, Any]:
    return {"obstacle": {"type": "box", "name": name, "size": [0.1, 0.1, 0.1]}, "largest_speed": speed}


def seen(name: str = "crate", **fields: Any) -> dict[str, Any]:
    return {"name": name, "time": 0.0, "placement": {"position": [1.5, 1.5, 0.5]}, **fields}


def opened(**fields: Any) -> Stream:
    empty = {"name": "empty", "obstacles": []}
    return Stream(**{"robot": "ur5", "scene": empty, "goal": GOAL, "start": START, **fields})


def held(x: float, radius: float = 0.05) -> list[dict[str, Any]]:
    shape = {"type": "sphere", "name": "apple", "radius": radius}
    return [{"obstacle": shape, "link": "ee_link", "placement": {"position": [x, 0.0, 0.0]}}]


def test_a_name_stands_once_among_what_is_declared_together() -> None:
    with pytest.raises(MalformedRequest, match=r"`obstacles\[1\]\.obstacle\.name`: 'crate' is the name of"):
        opened(obstacles=[crate(0.9), crate(0.2)])
    with opened(obstacles=[crate()]) as stream:
        with pytest.raises(MalformedRequest, match=r"`declare\[2\]\.obstacle\.name`: 'other' is the name of"):
            stream.update(time=0.0, declare=[crate(), crate(name="other"), crate(name="other")])
        assert isinstance(stream.update(time=0.0, declare=[crate(0.3)], obstacles=[seen()]), Piece)


@pytest.mark.parametrize("pair", [("crate", "nolink"), ("later", "forearm_link")])
def test_an_allowed_pair_of_what_nobody_knows_is_refused(pair: tuple[str, str]) -> None:
    told = r"`allowed_collisions\[1\]` names .* what is to be seen later is declared in `obstacles`"
    with pytest.raises(UnknownObject, match=told) as refused:
        opened(obstacles=[crate()], allowed_collisions=[("crate", "forearm_link"), pair])
    assert refused.value.details["path"] == "$.allowed_collisions[1]"


def test_what_is_odd_about_shapes_is_told_as_in_a_scene() -> None:
    corners = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]
    mesh = {"type": "mesh", "name": "sheet", "vertices": corners, "triangles": [[0, 1, 2]]}
    hall = {"type": "box", "name": "hall", "size": [300.0, 300.0, 300.0], "position": [0.0, 0.0, 400.0]}
    with opened(scene={"name": "odd", "obstacles": [mesh, hall]}) as stream:
        told = stream.warnings
    assert len(told) == 2
    with opened(obstacles=[{"obstacle": one, "largest_speed": 0.1} for one in (mesh, hall)]) as stream:
        assert stream.warnings == told
    with opened() as stream:
        assert stream.warnings == ()
        stream.update(time=0.0, declare=[{"obstacle": mesh, "largest_speed": 0.1}])
        assert stream.warnings == told[:1]


def test_a_half_space_never_turns() -> None:
    with pytest.raises(SceneInvalid, match=r"`\$\.obstacles\[0\]`: .*`assume\.angular_speed` must be 0"):
        opened(obstacles=[HALF_SPACE], assume={"speed": 0.1, "angular_speed": 0.1})
    with opened(obstacles=[HALF_SPACE], assume={"speed": 0.1}) as stream:
        turning = seen("wall", placement={}, angular_velocity=[1.0, 0.0, 0.0])
        with pytest.raises(MalformedRequest, match="its `angular_velocity` must be 0") as refused:
            stream.update(time=0.0, obstacles=[turning])
        assert refused.value.details["path"] == "$.obstacles[0].angular_velocity"
        assert isinstance(stream.update(time=0.02, obstacles=[seen("wall", placement={})]), Piece)


def test_one_that_is_closed_answers_nothing_more() -> None:
    with opened() as stream:
        stream.update(time=0.0)
    with pytest.raises(StreamUnknown, match="the stream is closed"):
        stream.update(time=0.02)
    with pytest.raises(StreamUnknown, match="the stream is closed"):
        stream.aim_for(GOAL)


def test_what_touches_at_the_start_is_told_also_where_there_is_no_goal() -> None:
    scene = {"name": "ball", "obstacles": [BALL]}
    with opened(scene=scene, goal=None) as stream:
        assert "at the start 'forearm_link' touches 'ball'" in stream.warnings
        state = stream.update(time=0.0)
    assert (state.reason, state.pair, state.time) == ("standing", None, None)
    with pytest.raises(InvalidGoal, match=r"the goal touches .* 4 mm; at the start 'upper_arm_link' touches 'ball'"):
        opened(scene=scene)


def test_a_refused_goal_is_told_what_goals_keep() -> None:
    with pytest.raises(InvalidGoal, match="closer to the scene than 54 mm"):
        opened(scene={"name": "ball", "obstacles": [BALL]}, min_clearance=0.05)


UNDER_THE_GOAL = {"position": [0.286, 0.536, 0.49]}
"""There an apple that the tool holds at the goal would be in the crate, and nothing else of the robot."""


BESIDE_THE_START = [0.463, 0.109, 0.90]  # there the crate is in the apple that the tool holds at the start


def test_what_is_held_is_kept_from_what_moves() -> None:
    for objects in ([], held(0.12)):
        with opened(obstacles=[crate(0.0)], attached_objects=objects) as stream:
            arrived = False
            for k in range(120):
                observed = [seen(time=0.02 * k, placement=UNDER_THE_GOAL)]
                answer = stream.update(time=0.02 * k, obstacles=observed)
                arrived |= isinstance(answer, Piece) and answer.reaches_goal
                if objects and isinstance(answer, Piece):
                    _is_apart(stream)
            assert arrived == (not objects)


def test_what_is_held_is_named_where_it_is_too_close() -> None:
    with opened(obstacles=[crate(0.0)], attached_objects=held(0.12)) as stream:
        state = stream.update(time=0.0, obstacles=[seen(placement={"position": BESIDE_THE_START})])
    assert (state.reason, state.pair) == ("too_close", ("apple", "crate"))


def _is_apart(stream: Stream) -> None:
    """The apple stands apart from the crate, by plain Pinocchio and Coal."""
    group = stream.group
    placed = group.geometry.createData()
    q = group.expand_from_local(stream.executing.ends)
    pin.updateGeometryPlacements(group.model, group.model.createData(), group.geometry, placed, q)
    apple = next(k for k in range(group.geometry.ngeoms) if group.robot.link_of_geometry(k) == "apple")
    here = coal.Transform3s(np.eye(3), placed.oMg[apple].translation)
    there = coal.Transform3s(np.eye(3), np.array(UNDER_THE_GOAL["position"]))
    asked, told = coal.DistanceRequest(), coal.DistanceResult()
    assert coal.distance(coal.Sphere(0.05), here, coal.Box(0.1, 0.1, 0.1), there, asked, told) > 0.0


@pytest.mark.filterwarnings("error")
def test_places_on_a_path_are_the_same_however_slow_joints_are() -> None:
    rng = np.random.default_rng(5)
    points, z = rng.normal(size=(6, 3)), rng.normal(size=3)
    plain = TimedPath(points, np.array([1.0, 2.0, 3.0]))
    for slowed in (1e-3, 1e-300):
        path = TimedPath(points, slowed * np.array([1.0, 2.0, 3.0]))
        assert path.nearest(z, 0.0, np.inf) * slowed == pytest.approx(plain.nearest(z, 0.0, np.inf), rel=1e-9)
