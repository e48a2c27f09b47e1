"""The first view of a recording: the eye from which obstacles hide least of the motion, and a layout of tabs.

Entities are named as `recorder.py` and the files of entities write them; tabs and plots without any are left out. The
numbers here decide what a viewer shows first, and which obstacles are drawn translucent, in the recording itself.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from guidefield.recorder.chunks import GHOST_ENTITY, PICTURE, PICTURE_AT_START, STEP

if TYPE_CHECKING:
    from guidefield.scene.obstacle import Obstacle

FAINT_GHOSTS = rr.Mesh3D.from_fields(albedo_factor=(255, 255, 255, 18))  # ghosts where the robot itself is shown too
LOG_COLUMNS = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
SWITCHED_OFF = {path: rrb.EntityBehavior(visible=False) for path in ("/robot/collision", "/robot/spheres")}
"""Entities that are hidden at first: the collision shapes, and their bounding spheres."""
BACKGROUND = (13, 16, 17)  # colour around the picture of the field (RGB), as that of the viewer
STEPS_SO_FAR = rrb.VisibleTimeRanges(
    timeline=STEP, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(seq=0)
)
"""All steps up to the one at the cursor."""


@dataclass(frozen=True, eq=False)
class Eye:
    """A position and a target (3,) [m, world], and the names of obstacles that hide part of the tip's path."""

    position: np.ndarray
    target: np.ndarray
    hiding: frozenset[str]


def layout(eye: Eye, timeline: str, present: Set[str]) -> rrb.Blueprint:
    """Lay out a recording, shown along a timeline; tabs and plots of entities that aren't present are left out."""
    tabs = [_overview(eye, present)]
    if "/planner/log" in present:
        tabs.append(_planner(eye, present))
    if not present.isdisjoint({PICTURE, PICTURE_AT_START}):
        tabs.append(_field(eye, PICTURE in present))
    return blueprint(rrb.Tabs(*tabs, *_joints(present), _documents(), active_tab=0), timeline)


def blueprint(views: Any, timeline: str) -> rrb.Blueprint:
    """Lay out some views, with all panels collapsed, playing a timeline."""
    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, loop_mode="all", play_state="playing"),
        auto_views=False,
        auto_layout=False,
    )


def _overview(eye: Eye, present: Set[str]) -> rrb.Horizontal:
    potentials = ["/plots/potential", "/planner/potential"]
    plots = [
        (1.0, _plot("/plots/clearance", "Clearance [m]"), ["/plots/clearance"]),
        (1.0, _plot("/plots/deviation", "Off the planned motion [rad, m]"), ["/plots/deviation"]),
        (0.8, _plot("/", "Potential of the robot [m]", potentials, legend=False), potentials),
    ]
    shown = [(share, view) for share, view, entities in plots if not present.isdisjoint(entities)]
    figures = rrb.Vertical(
        rrb.TextDocumentView(origin="/documents/summary", name="Summary"),
        *(view for _, view in shown),
        row_shares=[2.4, *(share for share, _ in shown)],
    )
    moving = ["/robot/**", "/path/**", GHOST_ENTITY]
    pictures = rrb.Tabs(
        scene_view("Motion", eye, moving, {GHOST_ENTITY: FAINT_GHOSTS, **SWITCHED_OFF}),
        scene_view("Whole path", eye, [GHOST_ENTITY, "/path/tip", "/path/to_follow"], {}),
        active_tab=0,
    )
    return rrb.Horizontal(pictures, figures, column_shares=[1.75, 1.0], name="Overview")


def _planner(eye: Eye, present: Set[str]) -> rrb.Horizontal:
    words = [rrb.TextLogView(origin="/planner/log", name="What the planner did", columns=LOG_COLUMNS)]
    if "/planner/potential" in present:
        words.append(_plot("/planner/potential", "Potential by step [m] (choose the timeline 'step')", legend=False))
    shown = ["/robot/visual/**", "/robot/at_fault/**", "/planner/**", "/path/planned", "/path/goal", "/path/failure"]
    so_far = {path: STEPS_SO_FAR for path in ("/planner/tip", "/planner/connect/tree") if path in present}
    steps = scene_view("Steps (choose the timeline 'step')", eye, shown, so_far)
    return rrb.Horizontal(
        steps, rrb.Vertical(*words, row_shares=[2.0, 1.0][: len(words)]), column_shares=[1.4, 1.0], name="Planner"
    )


def _field(eye: Eye, at_rest: bool) -> rrb.Horizontal:
    shown = ["/robot/collision/**", "/field/charges/**", "/field/forces", "/field/slice", "/path/tip"]
    forces = scene_view("Forces on links, charged points by force (red: strong, blue: a hundredth)", eye, shown, {})
    when = "" if at_rest else " before obstacles move"
    words = f"Potential in the plane of the tip's path{when} (dark: far; lines: as 1, 2, 5, 10 .. cm from a wall)"
    picture = rrb.Spatial2DView(
        origin=PICTURE if at_rest else PICTURE_AT_START,
        name=words,
        background=rrb.Background(color=BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
    )
    return rrb.Horizontal(forces, picture, column_shares=[1.2, 1.0], name="Field")


def _joints(present: Set[str]) -> list[rrb.Grid]:
    plots = [
        ("/plots/position", "Positions [rad, m]"),
        ("/plots/use/position", "Positions between their limits"),
        ("/plots/velocity", "Velocities [rad/s, m/s]"),
        ("/plots/use/velocity", "Velocities as shares of their limits"),
        ("/plots/acceleration", "Accelerations [rad/s², m/s²]"),
        ("/plots/use/acceleration", "Accelerations as shares of their limits"),
    ]
    shown = [_plot(origin, name) for origin, name in plots if origin in present]
    return [rrb.Grid(*shown, grid_columns=min(len(shown), 2), name="Joints")] if shown else []


def _documents() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(origin="/documents/request", name="Request"),
        rrb.TextDocumentView(origin="/documents/reply", name="Reply"),
        name="Documents",
    )


def _plot(origin: str, name: str, contents: Sequence[str] = ("/**",), *, legend: bool = True) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=origin,
        contents=[f"+ $origin{path}" for path in contents],
        name=name,
        plot_legend=None if legend else rrb.PlotLegend(visible=False),
    )


def scene_view(name: str, eye: Eye, contents: list[str], overrides: dict[str, Any]) -> rrb.Spatial3DView:
    """Make a view of obstacles, guide planes and other entities from an eye, with overrides by entity."""
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=[f"+ {path}" for path in ("/obstacles/**", "/guide_planes", *contents)],
        overrides=overrides,
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)),
    )


AZIMUTHS = 16  # number of horizontal directions that are tried
ELEVATIONS = (0.35, 0.65)  # angles above the horizon that are tried [rad]
PREFERRED_AZIMUTH = 1.96  # best azimuth of the eye from the direction of the motion [rad]: to its side, a little behind
TRIED_AT_ONCE = 4  # eyes whose rays are cast together, those of preferred directions first
PREFERENCE = 1.2  # share of hidden points that the preferred direction makes up for
DISTANCE = 1.9  # distance of the eye, as a multiple of the radius of its target
SMALLEST_RADIUS = 0.35  # smallest radius of the target, at size 1 [m]
SAMPLES = 8  # points of the tip's path that should be visible
MOST_TRIANGLES = 1500  # triangles that may hide something; of more, the largest
HIDING_SHARE = 0.1  # share of these points from which on an obstacle that hides them is drawn translucent


def choose_eye(
    tip: np.ndarray, robot: np.ndarray, landmarks: np.ndarray, obstacles: Sequence[Obstacle], size: float = 1.0
) -> Eye:
    """Choose the eye of a view by the tip's path (n, 3) [m, world] and what obstacles hide of it.

    Points of the robot (m, 3) and landmarks (k, 3), such as guide planes, are to be in the picture too. `size`, that of
    the robot, scales distances.
    """
    seen = np.vstack([tip, robot, landmarks])
    lowest, highest = seen.min(axis=0), seen.max(axis=0)
    target = 0.5 * (lowest + highest)
    distance = DISTANCE * max(0.5 * float(np.linalg.norm(highest - lowest)) + 0.15 * size, SMALLEST_RADIUS * size)
    points = tip[np.unique(np.linspace(0, len(tip) - 1, SAMPLES).astype(int))]
    corners, owners = _occluders(obstacles)
    forward = np.vstack([tip, landmarks]).mean(axis=0) - robot.mean(axis=0)
    heading = float(np.arctan2(forward[1], forward[0]))
    directions, preferences = _directions(heading)
    eyes = target + distance * directions
    best, least, hiding = 0, np.inf, np.empty((0, 0), bool)
    for rows in np.split(np.argsort(-preferences, kind="stable"), range(TRIED_AT_ONCE, len(eyes), TRIED_AT_ONCE)):
        if least <= -PREFERENCE * preferences[rows[0]]:  # not even a free view from there is better
            break
        hits = _hits(eyes[rows], points, corners)
        scores = hits.any(axis=2).mean(axis=1) - PREFERENCE * preferences[rows]
        if scores.min() < least:
            first = int(np.argmin(scores))
            best, least, hiding = int(rows[first]), float(scores[first]), hits[first]
    return Eye(eyes[best], target, _hiding(hiding, owners, obstacles))


def _directions(heading: float) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (e, 3) from the target to the eye, and how much each is preferred, at most 1, shape (e,)."""
    azimuths = np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False)
    elevation, azimuth = (angles.ravel() for angles in np.meshgrid(ELEVATIONS, azimuths, indexing="ij"))
    level, flat = np.cos(elevation), heading + azimuth
    off = np.abs(np.abs(azimuth) - PREFERRED_AZIMUTH) / np.pi
    side = np.where(azimuth < 0.0, 0.05, 0.0)  # of two mirrored views, always the same one
    return np.column_stack([level * np.cos(flat), level * np.sin(flat), np.sin(elevation)]), 1.0 - off - side


def _occluders(obstacles: Sequence[Obstacle]) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (t, 3, 3) of all obstacles but clouds, the largest first, and their obstacles' indices (t,)."""
    solid = [index for index, obstacle in enumerate(obstacles) if obstacle.cloud is None]
    if not solid:
        return np.empty((0, 3, 3)), np.empty(0, int)
    corners = np.concatenate([obstacles[index].vertices[obstacles[index].triangles] for index in solid])
    owners = np.repeat(solid, [len(obstacles[index].triangles) for index in solid])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    largest = np.argsort(-areas, kind="stable")[:MOST_TRIANGLES]
    return corners[largest], owners[largest]


def _hits(eyes: np.ndarray, points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Mark the triangles (t, 3, 3) that cut the segments from eyes (e, 3) to points (n, 3): shape (e, n, t).

    Source: T. Möller, B. Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997.
    """
    rays = points - eyes[:, None]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = eyes[:, None] - corners[:, 0]
    turned = np.cross(offset, first)
    determinant = -rays @ np.cross(first, second).T
    inverse = 1.0 / np.where(np.abs(determinant) < 1e-12, np.inf, determinant)
    u = rays @ np.cross(second, offset).swapaxes(1, 2) * inverse
    v = rays @ turned.swapaxes(1, 2) * inverse
    along = np.einsum("etk,tk->et", turned, second)[:, None] * inverse
    inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (inverse != 0.0)
    cut: np.ndarray = inside & (along > 1e-6) & (along < 1.0 - 1e-6)
    return cut


def _hiding(hits: np.ndarray, owners: np.ndarray, obstacles: Sequence[Obstacle]) -> frozenset[str]:
    """Return the names of obstacles that hide many of the points, by which triangles hide which (n, t)."""
    cutting = np.flatnonzero(hits.any(axis=0))
    shares = {index: hits[:, owners == index].any(axis=1).mean() for index in np.unique(owners[cutting]).tolist()}
    return frozenset(obstacles[index].name for index, share in shares.items() if share > HIDING_SHARE)
