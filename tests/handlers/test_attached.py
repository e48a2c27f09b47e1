"""Plans with a held object: it is kept free all along, as Coal sees it on a robot that doesn't know of it."""

import functools

import coal
import numpy as np
import pinocchio as pin
import pytest
from msgspec import convert

from guidefield.errors import MalformedRequest, SceneInvalid, UnknownObject
from guidefield.handlers.attached import holding
from guidefield.messages import codec, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import AttachedObject
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.handlers.motions import Bare, distance
from tests.handlers.test_plan import READY, ask as plan, joints
from tests.robots import robot

SIZE, OFFSET = (0.02, 0.02, 0.25), 0.22
ROD = {
    "obstacle": {"type": "box", "name": "rod", "size": SIZE, "position": (0, 0, 0), "quaternion_xyzw": (0, 0, 0, 1)},
    "link": "panda_hand",
    "placement": {"position": (0, 0, OFFSET)},
    "touch_links": ["panda_leftfinger", "panda_rightfinger"],
}


ask = functools.partial(plan, "bookshelf", start=READY, guide_planes=[])


def rod_distance(reply: PlanReply) -> float:
    """Smallest distance of the rod to the scene's obstacles, the hand placed by the bare robot."""
    bare, rod, obstacles = (
        Bare(reply.position_names),
        coal.Box(*SIZE),
        build(scenes.read_packaged("bookshelf")).obstacles,
    )
    distances = []
    for q in reply.trajectory.positions:
        bare.stand(np.array(q))
        held = bare.frame("panda_hand") * pin.SE3(np.eye(3), np.array([0, 0, OFFSET]))
        distances.append(min(distance(rod, held, one.shape, one.placement) for one in obstacles))
    return min(distances)


def test_what_is_held_is_kept_free_and_counts_in_the_clearance() -> None:
    goal = {"type": "joints", "positions": {**READY, "panda_joint1": 0.5, "panda_joint4": -1.9}}
    held = ask(goal=goal, attached_objects=[ROD])
    assert held.status.name == "SUCCESS", held.status.message
    nearest = rod_distance(held)
    assert nearest > 0.0
    assert held.clearance.minimum <= nearest + 2e-3
    bare = ask(goal=goal)
    assert bare.clearance.minimum >= held.clearance.minimum
    assert bare.clearance.inner > held.clearance.inner


def test_what_is_held_may_touch_what_is_allowed() -> None:
    bare = Bare(list(READY))
    bare.stand(np.array(list(READY.values())))
    end = bare.frame("panda_hand").act(np.array([0, 0, OFFSET + 0.12]))
    ball = {"type": "sphere", "name": "ball", "radius": 0.02, "position": end.tolist()}
    asked = {"goal": joints(**READY | {"panda_joint1": 0.4}), "attached_objects": [ROD], "start": READY}
    refused = plan({"name": "s", "obstacles": [ball]}, **asked)
    assert refused.status.name == "START_STATE_IN_COLLISION"
    assert refused.status.details["pair"] == ["rod", "ball"]
    allowed = plan({"name": "s", "obstacles": [ball]}, **asked, allowed_collisions=[["rod", "ball"]])
    assert allowed.status.name == "SUCCESS"


def test_what_can_not_be_held_is_refused_by_name() -> None:
    goal = {"type": "joints", "positions": READY}
    floor = {"obstacle": {"type": "half_space", "name": "f", "normal": (0, 0, 1), "offset": 0.0}, "link": "panda_hand"}
    with pytest.raises(MalformedRequest, match=r"attached_objects\[0\]"):
        ask(goal=goal, attached_objects=[floor])
    name = build(scenes.read_packaged("bookshelf")).obstacles[0].name
    taken = {**ROD, "obstacle": {**ROD["obstacle"], "name": name}}
    with pytest.raises(UnknownObject, match=name):
        ask(goal=goal, attached_objects=[taken])
    nothing = {"type": "box", "name": "speck", "size": (1e-150, 1e-150, 0.1)}
    with pytest.raises(SceneInvalid, match=r"attached_objects\[0\]`: 'speck' has a length of 1e-150 m"):
        ask(goal=goal, attached_objects=[{**ROD, "obstacle": nothing}])


def test_a_cloud_that_is_held_becomes_bodies_about_its_balls() -> None:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (8, 3))
    held = {**ROD, "obstacle": {"type": "point_cloud", "name": "cloud", "points": points.tolist(), "radius": 0.01}}
    empty = build(codec.decode(b'{"name": "empty"}', messages.Scene))
    panda = holding(robot("panda"), [convert(held, AttachedObject)], empty)
    shape = panda.geometry.geometryObjects[len(robot("panda").geometry.geometryObjects)].geometry
    vertices = np.array(shape.vertices()).reshape(8, -1, 3)
    assert np.linalg.norm(vertices - points[:, None], axis=2).min() > 0.01
    assert np.linalg.norm(vertices - points[:, None], axis=2).max() < 0.013
    held["obstacle"]["points"] = np.zeros((5001, 3)).tolist()
    with pytest.raises(SceneInvalid, match="thin it out"):
        holding(robot("panda"), [convert(held, AttachedObject)], empty)
