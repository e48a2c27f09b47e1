"""The field in a recording: a picture of it in the plane of the tip's way, flat and at its place in the scene."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.recorder.chunks import still
from guidefield.scene.field_slice import field_slice
from guidefield.scene.scene import Scene
from guidefield.scene.slice_plane import planes_along

PICTURE, PANE = "/field/picture", "/field/slice"
"""Entities of the flat picture and of the one at its place."""

RESOLUTION = 160
"""Pixels along the longer side of a picture of the field."""

QUALITY = 90
"""Of the picture's compression (JPEG, 0 to 100)."""

WAY_COLOR = (255, 255, 255, 255)


def picture_of_plane(scene: Scene, tip: np.ndarray) -> Iterator[Chunk]:
    """The field in the plane that fits the tip's way best: as a picture with the way on it, and at its place.

    Args:
        scene: What is charged; nothing is drawn of a scene without charge.
        tip: The tip's way, shape (n, 3) [m, world].
    """
    plane = planes_along(tip)[0]
    drawn = field_slice(scene, plane, RESOLUTION)
    if not np.isfinite(drawn.log_potential).any():
        return
    rows, columns = drawn.image.shape[:2]
    yield still(PICTURE, rr.Image(drawn.image).compress(jpeg_quality=QUALITY))
    way = rr.LineStrips2D([plane.projected(tip, rows, columns)], colors=[WAY_COLOR], radii=[0.4])
    yield still(f"{PICTURE}/way", way)
    pane = rr.Mesh3D(
        vertex_positions=plane.corners,
        triangle_indices=[(0, 2, 1), (0, 3, 2)],
        vertex_texcoords=[(0, 0), (1, 0), (1, 1), (0, 1)],
        albedo_texture=np.ascontiguousarray(drawn.image),
    )
    yield still(PANE, pane)
