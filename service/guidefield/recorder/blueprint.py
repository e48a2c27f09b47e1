"""How a viewer shows a recording at first: what matters at once, the rest one tab away."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from guidefield.recorder.camera import Eye
from guidefield.recorder.chunks import PATH_TIME

HIDDEN = ("/robot/collision",)
"""Entities that are there but switched off."""

BACKGROUND = (32, 36, 43)
GRID_SPACING = 0.25


def layout(eye: Eye) -> rrb.Blueprint:
    """The layout of a recording.

    Args:
        eye: From where to look at the scene.
    """
    return rrb.Blueprint(
        rrb.Tabs(_overview(eye), _planner(eye), _joints(), _documents(), active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=PATH_TIME, loop_mode="all", play_state="playing"),
        auto_views=False,
        auto_layout=False,
    )


def _overview(eye: Eye) -> rrb.Horizontal:
    figures = rrb.Vertical(
        rrb.TextDocumentView(origin="/documents/summary", name="Summary"),
        rrb.TimeSeriesView(origin="/plots/clearance", name="Clearance [m]", axis_y=rrb.ScalarAxis()),
        rrb.TimeSeriesView(origin="/plots/potential", name="Potential"),
        rrb.TimeSeriesView(origin="/plots/position", name="Joint positions [rad, m]"),
        row_shares=[2.2, 1.0, 0.8, 1.0],
    )
    motion = _scene("Motion", eye, ["/robot/**", "/obstacles/**", "/guide_planes/**", "/path/**", "/ghosts/**"])
    return rrb.Horizontal(motion, figures, column_shares=[1.75, 1.0], name="Overview")


def _planner(eye: Eye) -> rrb.Horizontal:
    words = rrb.Vertical(
        rrb.TextLogView(origin="/planner/log", name="What the planner did"),
        rrb.TimeSeriesView(origin="/planner/potential", name="Potential by step (choose the timeline 'step')"),
        row_shares=[2.0, 1.0],
    )
    steps = _scene(
        "Steps (choose the timeline 'step')", eye, ["/robot/**", "/obstacles/**", "/guide_planes/**", "/planner/tip", "/path/planned/**"]
    )
    return rrb.Horizontal(steps, words, column_shares=[1.4, 1.0], name="Planner")


def _joints() -> rrb.Grid:
    return rrb.Grid(
        rrb.TimeSeriesView(origin="/plots/position", name="Positions [rad, m]"),
        rrb.TimeSeriesView(origin="/plots/velocity", name="Velocities [rad/s, m/s]"),
        rrb.TimeSeriesView(origin="/plots/use/velocity", name="Velocities as shares of their limits"),
        rrb.TimeSeriesView(origin="/plots/use/acceleration", name="Accelerations as shares of their limits"),
        grid_columns=2,
        name="Joints",
    )


def _documents() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(origin="/documents/request", name="Request"),
        rrb.TextDocumentView(origin="/documents/reply", name="Reply"),
        name="Documents",
    )


def _scene(name: str, eye: Eye, contents: list[str]) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=[f"+ {path}" for path in contents],
        overrides={path: rrb.EntityBehavior(visible=False) for path in HIDDEN},
        background=rrb.Background(color=BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=GRID_SPACING, color=(255, 255, 255, 25)),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
        ),
        spatial_information=rrb.SpatialInformation("tf#/", axes=rr.ViewCoordinates.RIGHT_HAND_Z_UP),
    )
