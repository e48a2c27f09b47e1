"""The picture of the field: of the scene planned in, on the plane of the tip's way."""

from __future__ import annotations

import msgspec
import numpy as np
import pinocchio as pin
import pytest
import rerun as rr

from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.potential import RobotField
from guidefield.recorder.robot_entities import LONGEST_ARROW, RESOLUTION, charges, picture_of_plane
from guidefield.scene.scene import Scene, build
from tests.recorder.runs import placed_group

TIP = np.array([[-0.5, 0.0, 0.4], [0.0, 0.1, 0.5], [0.5, 0.0, 0.6]])


def test_there_is_a_flat_picture_with_the_way_and_one_at_its_place() -> None:
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


BESIDE_THE_HAND = (0.72, -0.02, 0.8)


def _ball(x: float, y: float, z: float) -> messages.Sphere:
    return messages.Sphere(name="ball", radius=0.1, position=(x, y, z))


@pytest.mark.parametrize("moved", [False, True], ids=["at rest", "moving"])
def test_points_are_coloured_by_the_force_on_them_and_arrows_sum_it_up(moved: bool) -> None:
    """Both are told by central differences of the potential alone."""
    group = placed_group("panda")
    box = messages.Box(name="box", size=(0.1, 0.2, 0.3), position=(0.0, 0.6, 0.5))
    ball, times = _ball(*BESIDE_THE_HAND), np.array([0.0, 1.0])
    if moved:
        there = [Placement(position=BESIDE_THE_HAND), Placement(position=(0.2, -0.5, 0.7))]
        route = messages.ObstacleTrajectory(times=times.tolist(), placements=there)
        ball = msgspec.structs.replace(ball, trajectory=route)
    scene = build(messages.Scene(name="s", obstacles=[box, ball]))
    first, second = scene.at(0.0), scene.at(1.0)
    qs = np.array([group.q_origin, group.q_origin + 0.2])
    chunks = list(charges(group, scene, times, qs, rr.TimeColumn("step", sequence=[0, 1])))
    batches = {(chunk.entity_path, chunk.is_static): chunk.to_record_batch() for chunk in chunks}
    forces = batches["/field/forces", False]
    arrows = forces.column("Arrows3D:vectors").to_pylist()
    strengths: list[list[float]] = [[], []]
    shown: list[list[int]] = [[], []]
    data = group.model.createData()
    field = RobotField(group, first)
    moving = field.charged[2] > 0
    joints = field.charged[2][moving]
    for joint in np.unique(joints):
        own, name = joints == joint, group.model.names[int(joint)]
        points = np.array(batches[f"/field/charges/{name}", True].column("Points3D:positions").to_pylist()[0])
        (frame,) = batches[f"/field/charges/{name}", True].column("CoordinateFrame:frame").to_pylist()
        assert frame == [f"joint {name}"]
        colors = batches[f"/field/charges/{name}", False].column("Points3D:colors").to_pylist()
        weights = field.charged[1][moving][own]
        for row, (scene, q) in enumerate(zip((first, second), qs, strict=True)):
            pin.forwardKinematics(group.model, data, group.expand(q))
            world = np.array([data.oMi[int(joint)].act(point) for point in points])
            strengths[row] += list(np.linalg.norm(_slope(scene, world), axis=1) * weights)
            shown[row] += [(color >> 24) - (color >> 8 & 255) for color in colors[row]]  # red over blue
    by_force, by_color = np.ravel(strengths), np.ravel(shown)
    order = np.argsort(by_force)
    assert (np.diff(by_color[order]) >= -3).all()  # to a rounding, the stronger the redder
    assert by_color.max() - by_color.min() > 200
    assert len(arrows) == 2
    assert max(np.linalg.norm(arrow) for row in arrows for arrow in row) == pytest.approx(LONGEST_ARROW, rel=1e-5)
    hand = np.array(forces.column("Arrows3D:origins").to_pylist()[0][-1])
    assert np.dot(arrows[0][-1], hand - BESIDE_THE_HAND) > 0.0


def _slope(scene: Scene, points: np.ndarray) -> np.ndarray:
    """grad Phi at points (n, 3) by central differences."""
    step = 1e-5
    ahead, behind = (
        np.array([field_at_points(scene.tables, points + sign * step * axis).potential for axis in np.eye(3)])
        for sign in (1.0, -1.0)
    )
    slope: np.ndarray = ((ahead - behind) / (2.0 * step)).T
    return slope
