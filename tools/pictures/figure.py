"""A recording laid out for print: white ground, pale obstacles, the robot from the side, from above and askew."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from guidefield.messages.scene import GuidePlane
from guidefield.recorder import bodies, surface
from guidefield.recorder.chunks import entity, still, write_recording
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

Colour = tuple[int, int, int, int]

WHITE = (255, 255, 255)
ORANGE = (228, 108, 40, 255)
PLANE = (0, 140, 150, 255)
PALE = (150, 168, 196, 42)
"""Obstacles (RGBA): one sees through several of them."""

WAY = "/ghosts"
"""Entity of the configurations along the motion, in grey levels."""

TRACE = "/path/tip"
STOP = "/path/stop"
"""Entity of where a stream's tip would stand."""

TO_STOP = "/path/to_stop"
MOVING = "/obstacles/single/"
PLANES = "/figure_planes"
TAKEN = ("/robot/", MOVING, WAY, TRACE, STOP, TO_STOP)
"""Entities of a recording that are in a figure."""

HIDDEN = ("/robot/collision", "/robot/spheres", "/robot/tip")

HALF_FIELD_OF_VIEW = np.tan(np.radians(55.0) / 2.0)
"""Half the height of what the viewer's eye sees, at distance 1."""


ROBOT = ("/robot/**",)

ASKEW = (-0.75, -1.7, 1.0)


@dataclass(frozen=True)
class View:
    """One view: from the target to the eye, what is up, entities shown beside obstacles and guide planes."""

    towards_eye: tuple[float, float, float] = ASKEW
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    drawn: tuple[str, ...] = ROBOT


@dataclass(frozen=True)
class Style:
    """Colours: the ground; obstacles by how their names begin; the robot (RGBA), None in its own. Space around it."""

    ground: tuple[int, int, int] = WHITE
    obstacles: dict[str, Colour] = field(default_factory=lambda: {"": PALE})
    robot: Colour | None = None
    margin: float = 1.06

    def obstacle(self, name: str) -> Colour:
        """The colour of the longest beginning of an obstacle's name."""
        return self.obstacles[max((start for start in self.obstacles if name.startswith(start)), key=len)]


SIDES = {"perspective": View(), "side": View((0.0, -1.0, 0.0)), "top": View((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))}


def write_figure(
    recording: Path,
    figure: Path,
    scene: Scene,
    planes: Sequence[GuidePlane],
    views: dict[str, View],
    aspect: float,
    style: Style,
    others: Sequence[Path] = (),
) -> None:
    """Write a recording's robot, among obstacles and guide planes drawn for print, with a layout of views only.

    Args:
        recording: A run's `.rrd`.
        figure: Where to.
        scene: Its scene; what moves is drawn as the recording has it.
        planes: Its guide planes.
        views: By name; three in a row.
        aspect: Width of a view by its height.
        style: Colours.
        others: Recordings of which the same has to be in the picture, so that pictures of all can be compared.
    """
    taken = [chunk for chunk in RrdReader(str(recording)).stream() if chunk.entity_path.startswith(TAKEN)]
    robot = tuple(chunk.entity_path for chunk in taken if chunk.entity_path.startswith("/robot/visual/"))
    outlines = [np.array([*plane.vertices, plane.vertices[0]]) for plane in planes]
    shown = np.vstack([_points(taken), *(_points(RrdReader(str(one)).stream()) for one in others), *outlines])
    moving = {
        chunk.entity_path: chunk.entity_path.removeprefix(MOVING)
        for chunk in taken
        if chunk.entity_path.startswith(MOVING) and chunk.to_record_batch().num_rows > 1
    }
    taken = [chunk for chunk in taken if not chunk.entity_path.startswith(MOVING) or chunk.entity_path in moving]
    still_ones = [one for one in scene.obstacles if one.name not in moving.values()]
    drawn = [
        *taken,
        *(_obstacle(one, style.obstacle(one.name)) for one in still_ones),
        *([still(PLANES, rr.LineStrips3D(outlines, colors=[PLANE], radii=[0.006]))] if outlines else []),
    ]
    tints = {path: style.obstacle(name) for path, name in moving.items()}
    if style.robot is not None:
        tints |= dict.fromkeys(robot, style.robot)
    cells = [_cell(name, view, shown, still_ones, tints, aspect, style) for name, view in views.items()]
    layout = rrb.Blueprint(
        rrb.Grid(*cells, grid_columns=min(len(cells), 3)),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="hidden", timeline="path_time"),
        auto_views=False,
        auto_layout=False,
    )
    write_recording(figure, figure.stem, drawn, layout)


def _points(chunks: Iterable[Chunk]) -> np.ndarray:
    """Points that have to be in the picture, shape (n, 3): the robot on its way, as ghosts have it, and its tip's path.

    Streams have neither: of them it is where the tip would stand.
    """
    found = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == WAY:
            found.append(np.array(batch.column("Mesh3D:vertex_positions")[0].as_py()))
        elif chunk.entity_path == TRACE:
            found += [np.array(strip) for strip in batch.column("LineStrips3D:strips")[0].as_py()]
        elif chunk.entity_path == STOP:
            found += [np.array(row) for row in batch.column("Points3D:positions").to_pylist()]
    return np.vstack(found)


def _obstacle(obstacle: Obstacle, colour: Colour) -> Chunk:
    return still(
        entity("figure", obstacle.name), bodies.mesh(surface.shade(obstacle.vertices, obstacle.triangles), colour)
    )


def _cell(
    name: str,
    view: View,
    shown: np.ndarray,
    obstacles: Sequence[Obstacle],
    tints: dict[str, Colour],
    aspect: float,
    style: Style,
) -> rrb.Spatial3DView:
    towards_eye = np.array(view.towards_eye) / np.linalg.norm(view.towards_eye)
    target, distance = framing(shown, towards_eye, np.array(view.up), aspect, style.margin)
    eye = target + distance * towards_eye
    overrides: dict[str, object] = {path: rr.Mesh3D.from_fields(albedo_factor=tint) for path, tint in tints.items()}
    overrides |= {path: rrb.EntityBehavior(visible=False) for path in HIDDEN}
    seen = [entity("figure", one.name) for one in obstacles if not hides_all(one.vertices, shown, eye)]
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=[f"+ {path}" for path in (*seen, PLANES, f"{MOVING}**", *view.drawn)],
        overrides=overrides,
        background=rrb.Background(color=style.ground, kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=view.up),
    )


def hides_all(vertices: np.ndarray, points: np.ndarray, eye: np.ndarray) -> bool:
    """Return whether a wall (m, 3) has all points (n, 3) on one side and the eye on the other."""
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    thinnest = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2][-1]
    sides = (points - middle) @ thinnest
    towards = (eye - middle) @ thinnest
    return bool((sides * towards).max() < 0.03 * abs(towards))


def framing(
    points: np.ndarray, towards_eye: np.ndarray, up: np.ndarray, aspect: float, margin: float
) -> tuple[np.ndarray, float]:
    """Return where to look and from how far, so that all points (n, 3) are in the picture, in its middle."""
    right = np.cross(up, towards_eye)
    right = right / np.linalg.norm(right)
    above = np.cross(towards_eye, right)
    axes = np.stack([right, above, towards_eye])
    seen = points @ axes.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    off = np.abs(seen - middle)
    needed = np.maximum(off[:, 0] / aspect, off[:, 1]) * margin / HALF_FIELD_OF_VIEW + (seen - middle)[:, 2]
    return axes.T @ middle, float(needed.max())
