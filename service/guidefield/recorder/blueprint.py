"""How a viewer shows a recording at first: what matters at once, the rest one tab away."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from guidefield.recorder.camera import Eye
from guidefield.recorder.chunks import STEP
from guidefield.recorder.field_entities import PANE, PICTURE
from guidefield.recorder.robot_entities import GHOST_ENTITY

HIDDEN = ("/robot/collision",)
"""Entities that are there but switched off."""

FAINT_GHOSTS = rr.Mesh3D.from_fields(albedo_factor=(255, 255, 255, 18))
"""Ghosts where the robot itself is shown too."""

BACKGROUND = (32, 36, 43)
LOG_COLUMNS = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])

SO_FAR = rrb.VisibleTimeRanges(
    timeline=STEP, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative(seq=0)
)
"""All steps up to the one that is looked at."""


def layout(eye: Eye, timeline: str, present: Set[str]) -> rrb.Blueprint:
    """The layout of a recording.

    Args:
        eye: From where to look at the scene.
        timeline: The timeline to begin with.
        present: Entities that the recording has: plots of others are left out.
    """
    field = [_field(eye)] if PICTURE in present else []
    return rrb.Blueprint(
        rrb.Tabs(_overview(eye, present), _planner(eye), *field, _joints(), _documents(), active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, loop_mode="all", play_state="playing"),
        auto_views=False,
        auto_layout=False,
    )


def _overview(eye: Eye, present: Set[str]) -> rrb.Horizontal:
    plots = [
        (1.0, _plot("/plots/clearance", "Clearance [m]"), ["/plots/clearance/obstacles"]),
        (
            0.8,
            _plot("/", "Potential of the robot [m]", ["/plots/potential", "/planner/potential"], legend=False),
            ["/plots/potential", "/planner/potential"],
        ),
        (0.9, _plot("/plots/position", "Joint positions [rad, m]", legend=False), ["/plots/position"]),
    ]
    shown = [(share, view) for share, view, entities in plots if not present.isdisjoint(entities)]
    figures = rrb.Vertical(
        rrb.TextDocumentView(origin="/documents/summary", name="Summary"),
        *(view for _, view in shown),
        row_shares=[2.4, *(share for share, _ in shown)],
    )
    pictures = rrb.Tabs(
        _scene("Motion", eye, ["/robot/**", "/path/**", GHOST_ENTITY], {GHOST_ENTITY: FAINT_GHOSTS}),
        _scene("Whole way", eye, [GHOST_ENTITY, "/path/tip"], {}),
        active_tab=0,
    )
    return rrb.Horizontal(pictures, figures, column_shares=[1.75, 1.0], name="Overview")


def _planner(eye: Eye) -> rrb.Horizontal:
    words = rrb.Vertical(
        rrb.TextLogView(origin="/planner/log", name="What the planner did", columns=LOG_COLUMNS),
        _plot("/planner/potential", "Potential by step [m] (choose the timeline 'step')", legend=False),
        row_shares=[2.0, 1.0],
    )
    shown = ["/robot/**", "/planner/tip", "/path/planned/**"]
    steps = _scene("Steps (choose the timeline 'step')", eye, shown, {"/planner/tip": SO_FAR})
    return rrb.Horizontal(steps, words, column_shares=[1.4, 1.0], name="Planner")


def _field(eye: Eye) -> rrb.Horizontal:
    """Dark valleys between bright walls, that the robot follows; lines are where a wall 1, 2, 5 .. cm away acts so."""
    place = _scene("At its place", eye, ["/robot/**", "/path/**", PANE], {})
    picture = rrb.Spatial2DView(
        origin=PICTURE,
        name="Potential in the plane of the tip's way (dark: far; lines: as of a wall 1, 2, 5, 10 .. cm away)",
        background=rrb.Background(color=BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
    )
    return rrb.Horizontal(place, picture, column_shares=[1.0, 1.0], name="Field")


def _joints() -> rrb.Grid:
    return rrb.Grid(
        _plot("/plots/position", "Positions [rad, m]"),
        _plot("/plots/velocity", "Velocities [rad/s, m/s]"),
        _plot("/plots/use/velocity", "Velocities as shares of their limits"),
        _plot("/plots/use/acceleration", "Accelerations as shares of their limits"),
        grid_columns=2,
        name="Joints",
    )


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


def _scene(name: str, eye: Eye, contents: list[str], overrides: dict[str, Any]) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=[f"+ {path}" for path in ("/obstacles/**", "/guide_planes/**", *contents)],
        overrides={**{path: rrb.EntityBehavior(visible=False) for path in HIDDEN}, **overrides},
        background=rrb.Background(color=BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
        ),
    )
