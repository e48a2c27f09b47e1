"""Obstacles and the field in a recording: where they are and move, by plain arithmetic."""

import numpy as np
import pinocchio as pin

from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.recorder import entities
from guidefield.recorder.entities import RESOLUTION, picture_of_plane
from guidefield.scene.scene import build

HINGE = (1.0, 0.0, 0.0)
QUARTER = (0.0, 0.0, 0.7071067811865476, 0.7071067811865476)


def test_a_moving_obstacle_is_drawn_once_and_carried_along() -> None:
    box = messages.Box(
        name="parcel",
        size=(0.2, 0.1, 0.1),
        trajectory=messages.ObstacleTrajectory(
            times=[1.0, 3.0], placements=[Placement(position=(0.5, 0.0, 0.3)), Placement(position=(0.5, 0.8, 0.3))]
        ),
    )
    door = messages.Box(
        name="door",
        size=(0.4, 0.02, 0.6),
        trajectory=messages.ObstacleTrajectory(
            times=[0.0, 2.0], placements=[Placement(position=HINGE), Placement(position=HINGE, quaternion_xyzw=QUARTER)]
        ),
    )
    still = messages.Sphere(name="ball", radius=0.1, position=(0.0, 0.5, 0.5))
    scene = build(messages.Scene(name="s", obstacles=[box, door, still]))
    times = np.array([0.0, 1.0, 2.0, 2.5, 4.0])
    drawn = {chunk.entity_path: chunk.to_record_batch() for chunk in entities.obstacles(scene.obstacles, (), ())}
    moved = {chunk.entity_path: chunk.to_record_batch() for chunk in entities.moving(scene.obstacles, times)}
    assert set(drawn) == {"/obstacles/single/parcel", "/obstacles/single/door", "/obstacles/balls"}
    assert set(moved) == {"/obstacles/single/parcel", "/obstacles/single/door"}
    for name, corners_at in (
        ("parcel", lambda t: _corners(box) + np.array([0.5, 0.4 * np.clip(t - 1.0, 0.0, 2.0), 0.3])),
        ("door", lambda t: _corners(door) @ pin.utils.rotate("z", np.pi / 4 * min(t, 2.0)).T + np.array(HINGE)),
    ):
        first = np.array(drawn[f"/obstacles/single/{name}"].column("Mesh3D:vertex_positions").to_pylist()[0])
        rows = moved[f"/obstacles/single/{name}"]
        shifts = rows.column("Transform3D:translation").to_pylist()
        turns = rows.column("Transform3D:quaternion").to_pylist()
        for time, (shift,), (turn,) in zip(times, shifts, turns, strict=True):
            shown = first @ pin.Quaternion(np.array(turn)).matrix().T + shift
            expected = corners_at(time)
            distances = np.linalg.norm(shown[:, None] - expected[None], axis=2)
            assert distances.min(axis=0).max() < 2e-6, (name, time)
            assert distances.min(axis=1).max() < 2e-6, (name, time)


def _corners(box: messages.Box) -> np.ndarray:
    """Of a box in its own frame, shape (8, 3)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return 0.5 * signs * box.size


TIP = np.array([[-0.5, 0.0, 0.4], [0.0, 0.1, 0.5], [0.5, 0.0, 0.6]])


def test_there_is_a_flat_picture_with_the_path_and_one_at_its_place() -> None:
    ball = messages.Sphere(name="ball", radius=0.1, position=(0.0, 0.4, 0.5))
    chunks = {
        chunk.entity_path: chunk.to_record_batch()
        for chunk in picture_of_plane(build(messages.Scene(name="s", obstacles=[ball])), TIP, (0.0, 0.0, 0.0))
    }
    assert set(chunks) == {"/field/picture", "/field/slice"}
    corners = np.array(chunks["/field/slice"].column("Mesh3D:vertex_positions").to_pylist()[0])
    across, down = corners[1] - corners[0], corners[3] - corners[0]
    shares = (TIP - corners[0]) @ np.array([across / (across @ across), down / (down @ down)]).T
    assert ((shares > 0.0) & (shares < 1.0)).all()
    way = np.array(chunks["/field/picture"].column("LineStrips2D:strips").to_pylist()[0][0])
    longest = max(np.linalg.norm(across), np.linalg.norm(down))
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(way, axis=0), axis=1),
        np.linalg.norm(np.diff(shares * [np.linalg.norm(across), np.linalg.norm(down)], axis=0), axis=1)
        * RESOLUTION
        / longest,
        rtol=0.05,
    )
