"""The page of `guidefield show --web` without a run: users drag the goal and obstacles, and each change is planned.

It plans in this process, without a service; needs ``guidefield[web]``. Numbers here change this page alone.
"""

from __future__ import annotations

import contextlib
import io
import threading
import time
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
import viser
from rich.console import Console

from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, Status
from guidefield.messages.certify_reply import describe_certificate
from guidefield.messages.requests import ForwardKinematics, PlanRequest, PoseGoal
from guidefield.messages.scene import Box, HalfSpace, Obstacle
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.values import Placement
from guidefield.recorder import bodies, surface
from guidefield.recorder.entities import obstacle_color
from guidefield.recorder.view import choose_eye
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.scene.scene import build
from guidefield.stores.scenes import PackagedScenes
from guidefield.viewer import LOOPBACK, has_display

FRAME_RATE = 30.0  # frames of the shown motion a second [Hz]
PAUSE_S = 0.7  # pause before the motion is shown again [s]
PLANNING_TIME_S = 10.0  # time that a plan may take [s]
BOX_SIDE = 0.12  # side of an added box [m]
PATH_COLOR = (120, 220, 160)  # colour of the tip's path (RGB)
MARKUP = frozenset("&<>|*`[]{}~#!\\\n")  # characters that Markdown may take for more than text
TRANSLUCENT = 0.35  # opacity of obstacles before the robot


@dataclass
class PageState:
    """The problem that the page shows at the moment."""

    goal: PoseGoal
    start: dict[str, Any]
    moved: dict[str, Placement] = field(default_factory=dict)  # placements of moved obstacles, by name
    added: list[Box] = field(default_factory=list)  # boxes that the user added


class TryPage:
    """The page of one robot in one scene; `run` plans whenever something has changed, and another thread plays motions.

    Viser's threads change the `PageState`, under a lock; once `run` has begun, only its thread asks the engine.

    Raises RobotInvalid or SceneInvalid if there is no such robot or scene.
    """

    def __init__(self, server: viser.ViserServer, robot: str, scene: str) -> None:
        self._server, self._robot, self._scene, self._engine = server, robot, scene, Engine()
        self._model = self._engine.robot(robot)
        self._message = PackagedScenes().read(scene)[0]
        self._changed, self._lock = threading.Event(), threading.Lock()
        self._frames: list[np.ndarray] = []
        self._reached: dict[str, Any] | None = None
        drawn = bodies.visual_bodies(self._model.source)[0] or bodies.collision_bodies(self._model)
        self._links = list(dict.fromkeys(body.link for body in drawn))
        described: Any = self._engine.answer({"type": "robot", "robot": robot})
        self._tip = described.tip
        start = configuration_to_wire(self._model.joints, self._model.rest)
        placed = self._place([start])[0]
        self._draw_robot(drawn, placed)
        self._draw_scene(placed)
        at = Placement(tuple(placed[-1, :3].tolist()), tuple(placed[-1, 3:].tolist()))
        self._state = PageState(PoseGoal(at.position, at.quaternion_xyzw), dict(start))
        self._handle = server.scene.add_transform_controls(
            "/goal", scale=0.25, position=at.position, wxyz=_wxyz(placed[-1])
        )
        self._handle.on_update(lambda _: self._aim())
        self._make_controls()  # last: a connected browser may use them at once

    def run(self) -> None:
        """Plan and show motions until the process ends."""
        threading.Thread(target=self._play_all, name="guidefield-play", daemon=True).start()
        while True:
            self._changed.wait()
            self._changed.clear()
            self._plan()

    def _place(self, configurations: Sequence[dict[str, Any]]) -> np.ndarray:
        """Return positions and quaternions (x, y, z, w) of the drawn links and the tip, shape (n, links + 1, 7)."""
        request = ForwardKinematics(self._robot, frames=[*self._links, self._tip], configurations=list(configurations))
        reply: Any = self._engine.answer(request)
        return np.array([[(*one.position, *one.quaternion_xyzw) for one in row] for row in reply.placements])

    def _draw_robot(self, drawn: Sequence[bodies.Body], placed: np.ndarray) -> None:
        scene = self._server.scene
        self._shown = [scene.add_frame(f"/robot/{link}", show_axes=False) for link in self._links]
        for body in drawn:
            path = f"/robot/{body.link}/{body.name}"
            if isinstance(body.surface, bytes):
                turned = pin.Quaternion(body.placement.rotation).coeffs()
                scene.add_glb(path, body.surface, position=body.placement.translation, wxyz=np.roll(turned, 1))
            else:
                colors = body.surface.colors
                color = body.color if colors is None else colors.mean(axis=0)
                scene.add_mesh_simple(
                    path, body.surface.vertices, body.surface.triangles, color=tuple(int(c) for c in color[:3])
                )
        self._show(placed)

    def _draw_scene(self, placed: np.ndarray) -> None:
        obstacles, size = build(self._message).obstacles, float(np.ptp(placed[:, :3], axis=0).max())
        eye = choose_eye(placed[-1:, :3], placed[:, :3], np.empty((0, 3)), obstacles, size)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.up = eye.position, eye.target, (0.0, 0.0, 1.0)
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_grid("/grid", width=4.0, height=4.0, cell_size=0.25, position=(0.0, 0.0, -0.002))
        for number, one in enumerate(obstacles):
            path, color = f"/scene/{one.name}", obstacle_color(one, number)[:3]
            if one.cloud is not None:
                scene.add_point_cloud(path, one.cloud.points, colors=color, point_size=one.cloud.radius)
            elif not isinstance(one.message, HalfSpace):
                drawn = surface.shade(one.vertices, one.triangles)
                at = np.array(getattr(one.message, "position", (0.0, 0.0, 0.0)))
                opacity = TRANSLUCENT if one.name in eye.hiding else None
                options: Any = {"color": color, "opacity": opacity, "position": at, "side": "double"}
                scene.add_mesh_simple(path, drawn.vertices - at, drawn.triangles, **options)

    def _make_controls(self) -> None:
        gui = self._server.gui
        gui.set_panel_label("guidefield")
        gui.configure_theme(dark_mode=True, control_width="large", show_logo=False, show_share_button=False)
        gui.add_markdown(
            f"**{_as_text(self._robot)}** in **{_as_text(self._scene)}**. "
            "Drag the handle at the tip: at each change the robot plans anew."
        )
        self._report = gui.add_markdown("")
        self._clearance = gui.add_slider("keep away [mm]", min=0, max=100, step=5, initial_value=0)
        self._clearance.on_update(lambda _: self._changed.set())
        movable = [one.name for one in self._message.obstacles if hasattr(one, "position")]
        self._chosen = gui.add_dropdown("move an obstacle", ["none", *movable])
        self._chosen.on_update(lambda _: self._choose())
        gui.add_button("Add a box").on_click(lambda _: self._add_box())
        gui.add_button("Go on from the goal").on_click(lambda _: self._start_there())
        self._mover: Any = None

    def _aim(self) -> None:
        w, *xyz = np.asarray(self._handle.wxyz).tolist()
        goal = PoseGoal(tuple(self._handle.position.tolist()), (*xyz, w))
        with self._lock:
            self._state.goal = goal
        self._changed.set()

    def _choose(self) -> None:
        if self._mover is not None:
            self._mover.remove()
            self._mover = None
        name = self._chosen.value
        found = [one for one in (*self._message.obstacles, *self._state.added) if one.name == name]
        if not found:
            return
        obstacle: Any = found[0]
        turned = getattr(obstacle, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
        at = self._state.moved.get(name, Placement(obstacle.position, turned))
        self._mover = mover = self._server.scene.add_transform_controls(
            "/mover", scale=0.25, position=at.position, disable_rotations=True
        )

        mover.on_update(lambda _: self._move(name, Placement(tuple(mover.position.tolist()), turned)))

    def _move(self, name: str, at: Placement) -> None:
        self._server.scene.get_handle_by_name(f"/scene/{name}").position = at.position
        with self._lock:
            self._state.moved[name] = at
        self._changed.set()

    def _add_box(self) -> None:
        with self._lock:
            name = f"box {len(self._state.added) + 1}"
            at = np.add(self._state.goal.position, (0.0, 2.5 * BOX_SIDE, 0.0))
            box = Box(name=name, size=(BOX_SIDE,) * 3, position=tuple(at.tolist()))
            self._state.added.append(box)
        self._server.scene.add_box(f"/scene/{name}", color=(240, 170, 90), dimensions=box.size, position=at)
        self._chosen.options = (*self._chosen.options, name)
        self._chosen.value = name
        self._changed.set()

    def _start_there(self) -> None:
        reached = self._reached
        if reached is not None:
            with self._lock:
                self._state.start = reached
            self._changed.set()

    def _plan(self) -> None:
        with self._lock:
            state = replace(self._state, moved=dict(self._state.moved), added=list(self._state.added))
        names = {one.name for one in state.added}
        added: list[Obstacle] = [
            Box(name=box.name, size=box.size, position=state.moved.get(box.name, box).position) for box in state.added
        ]
        request = PlanRequest(
            robot=self._robot,
            scene=RequestScene(
                base=self._scene, add=added, move={name: at for name, at in state.moved.items() if name not in names}
            ),
            start=state.start,
            goal=state.goal,
            guide_planes=[],
            min_clearance=1e-3 * self._clearance.value,
            allowed_planning_time=PLANNING_TIME_S,
            recording="off",
        )
        began = time.perf_counter()
        try:
            reply: Any = self._engine.answer(request)
        except GuidefieldError as error:
            self._tell(f"**{error.code.name}**: {_as_text(error.message)}")
            return
        seconds = time.perf_counter() - began
        if reply.status.code != Status.SUCCESS:
            self._frames, self._reached = [], None
            self._tell(f"**{reply.status.name}**: {_as_text(reply.status.message)}, in {1e3 * seconds:.0f} ms")
            return
        self._show_plan(reply, state.start)
        closest = reply.clearance
        between = f" between {' and '.join(map(_as_text, closest.pair))}" if closest.pair else ""
        away = "no obstacle" if closest.minimum is None else f"{1e3 * closest.minimum:.0f} mm{between}"
        self._tell(
            f"| | |\n|---|---|\n| status | **{reply.status.name}** |\n| planned in | {1e3 * seconds:.0f} ms |\n"
            f"| motion | {reply.metrics.duration:.2f} s |\n| clearance | {away} |\n"
            f"| certificate | {_as_text(describe_certificate(reply))} |"
        )

    def _tell(self, text: str) -> None:
        self._report.content = text

    def _show_plan(self, reply: Any, start: Mapping[str, Any]) -> None:
        motion = reply.trajectory
        rows = np.array(motion.positions)
        times = np.linspace(0.0, motion.times[-1], 2 + int(FRAME_RATE * motion.times[-1]))
        columns = [np.interp(times, motion.times, column) for column in rows.T]
        named = [dict(zip(reply.position_names, row, strict=True)) for row in np.column_stack(columns).tolist()]
        placed = self._place([{**start, **one} for one in named])
        way = placed[:, -1, :3]
        segments = np.stack([way[:-1], way[1:]], 1)
        self._server.scene.add_line_segments("/way", segments, colors=PATH_COLOR, thickness=0.006)
        self._reached = {**start, **named[-1]}
        self._frames = list(placed)

    def _play_all(self) -> None:
        while True:
            frames = self._frames
            for placed in frames:
                if frames is not self._frames:
                    break
                self._show(placed)
                time.sleep(1.0 / FRAME_RATE)
            else:
                time.sleep(PAUSE_S)

    def _show(self, placed: np.ndarray) -> None:
        with self._server.atomic():
            for frame, at in zip(self._shown, placed, strict=False):
                frame.position, frame.wxyz = at[:3], _wxyz(at)


def _wxyz(at: np.ndarray) -> np.ndarray:
    return np.roll(at[3:7], 1)


def _as_text(text: str) -> str:
    return "".join(f"&#{ord(one)};" if one in MARKUP else one for one in text)


def serve_page(robot: str, scene: str, port: int, out: Console) -> None:
    """Serve the page to browsers of this machine until Ctrl-C."""
    with contextlib.redirect_stdout(io.StringIO()):  # Viser prints addresses before there is anything to see
        server = viser.ViserServer(host=LOOPBACK, port=port, label="guidefield", verbose=False)
    try:
        page = TryPage(server, robot, scene)
        taken = server.get_port()
        occupied = "" if taken == port else f"port {port} is occupied; "
        url = f"http://{LOOPBACK}:{taken}"
        out.print(f"{occupied}the page is at {url}\nCtrl-C ends it.", highlight=False, soft_wrap=True)
        if has_display():
            webbrowser.open(url)
        page.run()
    except KeyboardInterrupt:
        return
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
