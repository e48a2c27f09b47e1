"""The picture of the field: of the scene planned in, on the plane of the tip's way."""

import numpy as np

from guidefield.messages import scene as messages
from guidefield.recorder.entities import RESOLUTION, picture_of_plane
from guidefield.scene.scene import build

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
