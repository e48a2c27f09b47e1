"""Plans made up for the recorder's tests, and recordings read back."""

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from guidefield.messages import replies, scene as messages
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.trace import (
    Event,
    EventLog,
    Note,
    PathRelaxed,
    StageEntered,
    StageLeft,
    Step,
    StepKind,
    TreeGrown,
)
from guidefield.recorder.documents import RecordedRun
from guidefield.recorder.recorder import record_plan
from guidefield.recorder.stored import RecordingPlace
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import Scene, build
from guidefield.versions import describe_versions as made_with_now
from tests.robots import robot

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.7), np.array([0.3, -0.1, 0.2]))
"""Where the robots of these tests stand: nowhere special, so that nothing is right by chance."""

MIN_CLEARANCE = 0.02


def placed_group(name: str) -> PlanningGroup:
    """A robot's default group at `PLACEMENT`."""
    model = robot(name)
    return select(model, None, None, model.rest, PLACEMENT)


@functools.cache
def robots_folder() -> Path:
    """Where robots are kept prepared while tests run."""
    return Path(tempfile.mkdtemp(prefix="guidefield-robots-"))


def every_kind() -> messages.Scene:
    """One obstacle of every kind that is served, and two guide planes; names that need escaping among them."""
    return messages.Scene(
        name="every kind",
        obstacles=[
            messages.Box(name="box / lid", size=(0.3, 0.2, 0.1), position=(0.6, 0.4, 0.3)),
            messages.Sphere(name="ball", radius=0.05, position=(0.6, -0.4, 0.3)),
            messages.Cylinder(name="can", radius=0.03, length=0.14, position=(0.7, 0.0, 0.4)),
            messages.Capsule(name="pill", radius=0.03, length=0.1, position=(0.7, 0.2, 0.4)),
            messages.Mesh(
                name="wedge",
                vertices=[(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)],
                triangles=[(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)],
                position=(-0.6, 0.0, 0.2),
            ),
            messages.Polygon(name="wall", vertices=[(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)]),
            messages.HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.3),
        ],
        guide_planes=[
            messages.GuidePlane(name="GP1", vertices=[(0.4, -0.2, 0.5), (0.4, 0.2, 0.5), (0.4, 0.2, 0.8)]),
            messages.GuidePlane(name="GP 2", vertices=[(0.5, -0.2, 0.5), (0.5, 0.2, 0.5), (0.5, 0.2, 0.8)]),
        ],
    )


@dataclass(frozen=True, eq=False)
class MadeUp:
    """A plan that nobody planned: everything a recorder is given."""

    group: PlanningGroup
    scene: Scene
    request: PlanRequest
    events: tuple[Event, ...]
    trajectory: Trajectory
    reply: replies.PlanReply
    profile: ClearanceProfile | None

    def record(self, path: Path, place: RecordingPlace | None = None, made_with: str | None = None) -> None:
        """Write the recording, with all that it needs unless a place is given."""
        log = EventLog()
        for event in self.events:
            log.add(event)
        place, versions = place or RecordingPlace(path, robots_folder(), whole=True), made_with or made_with_now()
        run = RecordedRun(self.group, self.scene, self.request, self.reply, self.profile, versions)
        record_plan(place, run, log)


def made_up(name: str = "panda", status: replies.Outcome | None = None) -> MadeUp:
    """A smooth motion of a robot from one random configuration to another; numbers that no planner would give."""
    group, scene = placed_group(name), build(every_kind())
    rng = np.random.default_rng(5)
    waypoints = np.cumsum(rng.normal(0.0, 0.3, (6, group.nv)), axis=0)
    times = np.cumsum(rng.uniform(0.2, 0.6, 6)) - 0.2
    times -= times[0]
    velocities = np.gradient(waypoints, times, axis=0)
    velocities[[0, -1]] = 0.0
    trajectory = Trajectory(times=times, positions=waypoints, velocities=velocities)
    profile = _profile(group, trajectory, rng)
    reply = _reply(group, scene, trajectory, status)
    goal = JointsGoal(positions={group.joints[0].name: 0.1})
    request = PlanRequest(robot=name, scene=scene.message, goal=goal, min_clearance=MIN_CLEARANCE, seed=3)
    events = (
        StageEntered("guide", "two guide planes to cross"),
        *(
            Step(StepKind(kind), group.from_local(z), f"step {i}", potential=None if i == 2 else 4.0 - 0.1 * i, plane=0)
            for i, (kind, z) in enumerate(
                zip(("start", "advance", "slide", "reorient", "advance"), waypoints, strict=False)
            )
        ),
        TreeGrown(lambda: grown_trees(group)),
        PathRelaxed(waypoints, 2.5),
        PathRelaxed(0.9 * waypoints, 1.5),
        Note("something odd", warning=True),
        StageLeft("guide", "reached", 0.008, plane=1),
    )
    return MadeUp(group, scene, request, events, trajectory, reply, profile)


def grown_trees(group: PlanningGroup) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Two trees of local coordinates that nobody searched with: a chain, and two roots with three children each."""
    rng = np.random.default_rng(7)
    chain, bushes = rng.uniform(-0.5, 0.5, (12, group.nv)), rng.uniform(-0.5, 0.5, (8, group.nv))
    return (chain, np.arange(-1, 11)), (bushes, np.array([-1, -1, 0, 0, 0, 1, 1, 1]))


def _profile(group: PlanningGroup, trajectory: Trajectory, rng: np.random.Generator) -> ClearanceProfile:
    times = np.linspace(0.0, trajectory.duration, 23)
    count = len(times)
    pairs: list[Any] = [("panda_hand", "box / lid")] * count
    pairs[4] = None
    distances = rng.uniform(-0.01, 0.2, count)
    distances[4] = np.inf
    potential = rng.uniform(1.0, 2.0, count)
    witness = rng.uniform(-1.0, 1.0, (count, 2, 3))
    witness[4] = np.nan
    return ClearanceProfile(
        times=times,
        configurations=np.array([group.from_local(z) for z in trajectory.evaluate(times)[0]]),
        lengths=np.linspace(0.0, 2.0, count),
        obstacle_distance=distances,
        obstacle_pair=tuple(pairs),
        witness=witness,
        self_distance=rng.uniform(0.0, 0.1, count),
        self_pair=(("panda_link5", "panda_link7"),) * count,
        potentials=lambda: (times, potential),
    )


def _reply(
    group: PlanningGroup, scene: Scene, trajectory: Trajectory, status: replies.Outcome | None
) -> replies.PlanReply:
    path = [group.wire_positions(z) for z in trajectory.positions]
    maps = [group.tangent_map(z) for z in trajectory.positions]
    return replies.PlanReply(
        run_id="run-1",
        status=status or replies.Outcome(code=1, name="SUCCESS", message="the tip reaches GP 2"),
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        path=path,
        trajectory=replies.Trajectory(
            times=trajectory.times.tolist(),
            positions=path,
            velocities=[(T @ v).tolist() for T, v in zip(maps, trajectory.velocities, strict=True)],
            accelerations=[(T @ a).tolist() for T, a in zip(maps, trajectory.accelerations, strict=True)],
        ),
        guide_planes=list(scene.message.guide_planes),
        stages=[replies.Stage(name="guide", outcome="reached", seconds=0.008, plane=0)],
        clearance=replies.ClearanceFigures(
            minimum=0.031, mean=0.09, inner=None, ends=0.031, pair=["panda_hand", "box / lid"], time=1.2
        ),
        self_clearance=replies.SelfClearance(minimum=0.021, pair=None),
        certificate=replies.CertificateFigures(
            collision_free=True, method="made up", covers="trajectory", evaluations=7
        ),
        metrics=replies.Metrics(
            joint_path_length=3.2, tip_path_length=0.9, duration=2.4, peak_jerk=40.0, smoothness=0.2
        ),
        timing=replies.Timing(guide=0.008, total=0.011),
        counters=replies.Counters(iterations=12, potential_evaluations=340, collision_checks=56),
        seed=3,
        planner="guided",
        recording=None,
        warnings=["the start was clamped"],
    )


class Recording:
    """A recording read back."""

    def __init__(self, path: Path) -> None:
        self._reader = RrdReader(path)
        self.chunks: list[Chunk] = self._reader.stream().to_chunks()

    @property
    def entities(self) -> set[str]:
        return {chunk.entity_path for chunk in self.chunks}

    def stores(self) -> tuple[list[Any], list[Any]]:
        """Its recordings and its blueprints."""
        return self._reader.recordings(), self._reader.blueprints()

    def batch(self, entity: str, timeline: str | None = None) -> pa.RecordBatch:
        """The one chunk of an entity on a timeline; None: that without times."""
        found = [
            chunk.to_record_batch()
            for chunk in self.chunks
            if chunk.entity_path == entity
            and (chunk.is_static if timeline is None else timeline in chunk.timeline_names)
        ]
        assert len(found) == 1, (entity, timeline, len(found))
        return found[0]

    def values(self, entity: str, component: str, timeline: str | None = None) -> list[Any]:
        """A component's rows as plain lists."""
        return self.batch(entity, timeline).column(component).to_pylist()

    def one(self, entity: str, component: str) -> list[Any]:
        """The component of an entity that holds at all times."""
        (row,) = self.values(entity, component)
        return row

    def times(self, entity: str, timeline: str) -> np.ndarray:
        """Times of an entity's rows: seconds, or counts."""
        column = self.batch(entity, timeline).column(timeline)
        integers = column.cast(pa.int64()).to_numpy()
        return integers * 1e-9 if pa.types.is_duration(column.type) else integers
