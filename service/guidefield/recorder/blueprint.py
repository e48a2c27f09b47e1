"""How a viewer shows a recording at first: what matters at once, the rest one tab away."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from guidefield.recorder.chunks import GHOST_ENTITY, PICTURE, PICTURE_AT_START, STEP

FAINT_GHOSTS = rr.Mesh3D.from_fields(albedo_factor=(255, 255, 255, 18))
"""Ghosts where the robot itself is shown too."""

LOG_COLUMNS = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])

SWITCHED_OFF = ("/robot/collision", "/robot/spheres")
"""What is there but not shown at first: the shapes that are judged, and the balls that contain them."""

BACKGROUND = (13, 16, 17)
"""Colour around the picture of the field (RGB), as that of the viewer."""

SO_FAR = rrb.VisibleTimeRanges(
    timeline=STEP, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(seq=0)
)
"""All steps up to the one that is looked at."""


@dataclass(frozen=True, eq=False)
class Eye:
    """A view of a scene.

    Attributes:
        position, target: Where the eye is and what it looks at, shape (3,) [m, world].
        hiding: Names of obstacles that hide part of the tip's way.
    """

    position: np.ndarray
    target: np.ndarray
    hiding: frozenset[str]


def layout(eye: Eye, timeline: str, present: Set[str]) -> rrb.Blueprint:
    """The layout of a recording.

    Args:
        eye: From where to look at the scene.
        timeline: The timeline to begin with.
        present: Entities that have something to show: tabs and plots of others are left out.
    """
    tabs = [_overview(eye, present)]
    if "/planner/log" in present:
        tabs.append(_planner(eye, present))
    if not present.isdisjoint({PICTURE, PICTURE_AT_START}):
        tabs.append(_field(eye, PICTURE in present))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, *_joints(present), _documents(), active_tab=0),
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
        _scene("Motion", eye, moving, {GHOST_ENTITY: FAINT_GHOSTS, **{path: _off() for path in SWITCHED_OFF}}),
        _scene("Whole way", eye, [GHOST_ENTITY, "/path/tip"], {}),
        active_tab=0,
    )
    return rrb.Horizontal(pictures, figures, column_shares=[1.75, 1.0], name="Overview")


def _planner(eye: Eye, present: Set[str]) -> rrb.Horizontal:
    words = [rrb.TextLogView(origin="/planner/log", name="What the planner did", columns=LOG_COLUMNS)]
    if "/planner/potential" in present:
        words.append(_plot("/planner/potential", "Potential by step [m] (choose the timeline 'step')", legend=False))
    shown = ["/robot/visual/**", "/robot/at_fault/**", "/planner/**", "/path/planned", "/path/goal", "/path/failure"]
    so_far = {path: SO_FAR for path in ("/planner/tip", "/planner/connect/tree") if path in present}
    steps = _scene("Steps (choose the timeline 'step')", eye, shown, so_far)
    return rrb.Horizontal(
        steps, rrb.Vertical(*words, row_shares=[2.0, 1.0][: len(words)]), column_shares=[1.4, 1.0], name="Planner"
    )


def _field(eye: Eye, at_rest: bool) -> rrb.Horizontal:
    shown = ["/robot/collision/**", "/field/charges/**", "/field/forces", "/field/slice", "/path/tip"]
    forces = _scene("Forces on links, charged points by force (red: strong, blue: a hundredth)", eye, shown, {})
    when = "" if at_rest else " before obstacles move"
    words = f"Potential in the plane of the tip's way{when} (dark: far; lines: as of a wall 1, 2, 5, 10 .. cm away)"
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


def _off() -> rrb.EntityBehavior:
    """There, but switched off."""
    return rrb.EntityBehavior(visible=False)


def _scene(name: str, eye: Eye, contents: list[str], overrides: dict[str, Any]) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=[f"+ {path}" for path in ("/obstacles/**", "/guide_planes", *contents)],
        overrides=overrides,
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)),
    )
