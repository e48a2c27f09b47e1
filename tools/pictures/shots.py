"""Pictures of one run: a sheet from all sides, an animation, a still, the tabs of the viewer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

import guidefield
from guidefield.messages.conditions import SceneReference
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import ForwardKinematics, PlanRequest, ReadRobot, ReadScene
from guidefield.messages.scene import GuidePlane
from guidefield.scene.scene import build
from pictures import compose
from pictures.figure import ORANGE, SIDES, WAY, Style, View, write_figure
from pictures.viewer import bring_forward, complaints, headless_viewer, open_recording, steady_picture

SHEET_WINDOW = (2100, 1100)
SHEET_WIDTH = 1800
BARS = 40
"""Height of the bars above a view [pixels]."""

FRAMES = 40
CLIP = (960, 640)
BESIDE = (720, 800)
TAB_WINDOW = (1600, 900)
TAB_WIDTH = 1200
TABS = ("Overview", "Planner", "Field", "Joints", "Documents")

Faults = Iterator[str]


@dataclass(frozen=True)
class Recorded:
    """A recording, the scene of it, and where its pictures go."""

    name: str
    scene: SceneReference
    recording: Path
    folder: Path

    def figure(self) -> Path:
        """Return where its recording with another layout lies."""
        return self.recording.with_name(f"{self.name}-figure.rrd")

    def draw(self, views: dict[str, View], aspect: float, style: Style, others: Sequence[Path] = ()) -> None:
        """Write that recording, framed as those of others."""
        scene = self.scene
        message = guidefield.answer(ReadScene(scene)).scene if isinstance(scene, str) else scene
        write_figure(self.recording, self.figure(), build(message), self.planes(), views, aspect, style, others)

    def planes(self) -> Sequence[GuidePlane]:
        """The guide planes that are drawn."""
        return ()


@dataclass(frozen=True)
class Planned(Recorded):
    """A plan that was recorded."""

    request: PlanRequest
    reply: PlanReply

    def planes(self) -> Sequence[GuidePlane]:
        """Those that the planner had."""
        return self.reply.guide_planes


def sheet(run: Planned) -> Faults:
    """As the thesis' figures: from three sides the start, guide planes, the goal, and the whole way in grey levels."""
    whole = {f"{side}, whole way": replace(view, drawn=(WAY,)) for side, view in SIDES.items()}
    aspect = SHEET_WINDOW[0] / 3 / (SHEET_WINDOW[1] / 2 - BARS)
    run.draw(SIDES | whole, aspect, Style(robot=ORANGE))
    stops = _moments(run.request, run.reply)
    cells: dict[str, list[Image.Image]] = {side: [] for side in SIDES}
    with headless_viewer(SHEET_WINDOW) as viewer:
        open_recording(viewer, run.figure())
        for _, at in stops:
            viewer.set_time("path_time", duration=at, play_state="paused")
            steady_picture(viewer, None)
            ids = {view.name: view.view_id for view in viewer.get_state().views}
            for side in SIDES:
                cells[side].append(compose.picture(viewer.take_screenshot(ids[side])))
        for side in SIDES:
            cells[side].append(compose.picture(viewer.take_screenshot(ids[f"{side}, whole way"])))
        yield from complaints(viewer)
    for side, images in cells.items():
        yield from (f"{side}, picture {i} is blank" for i, one in enumerate(images) if compose.is_blank(one))
    headings = [*(title for title, _ in stops), "the whole way"]
    compose.save(compose.sheet(list(cells.values()), headings, SHEET_WIDTH), run.folder / f"{run.name}.webp")


def _moments(request: PlanRequest, reply: PlanReply) -> list[tuple[str, float]]:
    """Start, where the tip crosses each guide plane, and the end: each with its time [s]."""
    about = guidefield.answer(ReadRobot(request.robot))
    rows = [_positions(reply.position_names, row) for row in reply.trajectory.positions]
    asked = ForwardKinematics(
        robot=request.robot, frames=[about.tip], configurations=rows, robot_placement=request.robot_placement
    )
    tip = np.array([placements[0].position for placements in guidefield.answer(asked).placements])
    times = reply.trajectory.times
    found = [("start", times[0])]
    for plane in reply.guide_planes[:-1]:
        corners = np.array(plane.vertices)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        side = (tip - corners[0]) @ normal
        at = int(np.argmax(side * side[0] <= 0.0))
        found.append((plane.name, times[at]))
    return [*found, ("goal", times[-1])]


def _positions(names: Sequence[str], row: Sequence[float]) -> dict[str, float | list[float]]:
    """A row of a path as a request wants it: `ball1.qx`, `ball1.qy` .. belong to one joint."""
    found: dict[str, float | list[float]] = {}
    for name, value in zip(names, row, strict=True):
        joint, dot, _ = name.rpartition(".")
        if dot:
            found.setdefault(joint, []).append(value)
        else:
            found[name] = value
    return found


def clip(run: Planned, view: View, style: Style) -> Faults:
    """The motion as an animation, at the pace at which it is to be executed, or slower where it lasts under 2.5 s."""
    duration = run.reply.trajectory.times[-1]
    yield from _frames(run, view, style, list(np.linspace(0.0, duration, FRAMES)), max(duration, 2.5))


def segment(run: Recorded, begin: float, end: float, view: View, style: Style) -> Faults:
    """The motion from one time to another [s] as an animation, at its own pace."""
    yield from _frames(run, view, style, list(np.linspace(begin, end, FRAMES)), end - begin)


def still(run: Planned, view: View, style: Style) -> Faults:
    """One picture, of the end."""
    end = 0.0 if run.reply.trajectory is None else run.reply.trajectory.times[-1]
    yield from _frames(run, view, style, [end], 0.0)


def _frames(run: Recorded, view: View, style: Style, times: list[float], seconds: float) -> Faults:
    window = (CLIP[0], CLIP[1] + 2 * BARS)
    run.draw({"motion": view}, CLIP[0] / CLIP[1], style)
    with headless_viewer(window) as viewer:
        state = open_recording(viewer, run.figure())
        (shown,) = (one.view_id for one in state.views)
        steady_picture(viewer, shown)
        images = []
        for at in times:
            if any(one.name == "path_time" for one in state.recordings[0].timelines):
                viewer.set_time("path_time", duration=at, play_state="paused")
            images.append(compose.picture(viewer.take_screenshot(shown)))
        yield from complaints(viewer)
    yield from (f"picture {i} is blank" for i, one in enumerate(images) if compose.is_blank(one))
    if len(images) > 1:
        if all(one.tobytes() == images[0].tobytes() for one in images):
            yield "nothing moves"
        compose.save_animation(images, run.folder / f"{run.name}.webp", seconds)
    else:
        compose.save(images[0], run.folder / f"{run.name}.webp")


def beside(runs: Sequence[Planned], view: View, style: Style, picture: Path) -> Faults:
    """Plans that differ in their objective, each after a third of its time, under duration and smallest distance."""
    images, headings = [], []
    for run in runs:
        others = [one.recording for one in runs if one is not run]
        run.draw({"motion": view}, BESIDE[0] / BESIDE[1], style, others)
        with headless_viewer((BESIDE[0], BESIDE[1] + 2 * BARS)) as viewer:
            (shown,) = (one.view_id for one in open_recording(viewer, run.figure()).views)
            viewer.set_time("path_time", duration=run.reply.trajectory.times[-1] / 3.0, play_state="paused")
            images.append(compose.picture(steady_picture(viewer, shown)))
            yield from complaints(viewer)
        away = round(1e3 * run.reply.clearance.minimum)
        headings.append(f"{run.request.objective}: {run.reply.metrics.duration:.2f} s, {away} mm away")
    yield from (f"{run.name} is blank" for run, one in zip(runs, images, strict=True) if compose.is_blank(one))
    compose.save(compose.sheet([images], headings, TAB_WIDTH), picture)


def tabs(run: Planned) -> Faults:
    """The viewer as it opens the recording, tab by tab."""
    with headless_viewer(TAB_WINDOW) as viewer:
        open_recording(viewer, run.recording)
        steady_picture(viewer, None)
        for tab in TABS:
            bring_forward(viewer, tab)
            if tab == "Planner":
                viewer.set_time("step", sequence=run.reply.counters.iterations // 2, play_state="paused")
            elif run.reply.trajectory is not None:
                viewer.set_time("path_time", duration=0.6 * run.reply.trajectory.times[-1], play_state="paused")
            image = compose.picture(steady_picture(viewer, None))
            if compose.is_blank(image):
                yield f"the tab {tab} is blank"
            compose.save(compose.scaled(image, TAB_WIDTH), run.folder / f"tab_{tab.lower()}.webp")
            yield from complaints(viewer)
