"""The obstacles of a stream: shapes made once, observed places rewritten in the arrays that the judge reads.

Parts, growths and margins enter the proof: they may be larger than promised in docs/stream.md, never smaller. `boxes`
are for planning alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.part_tables import PartsTable
from guidefield.collision.solids import solid_of_obstacle
from guidefield.errors import MalformedRequest, RequestTooLarge, SceneInvalid, UnknownObject
from guidefield.geometry.surfaces import frames
from guidefield.kernels.prove.tables import MovingObstacles, ObstacleBodies
from guidefield.messages import scene as messages
from guidefield.messages.streams import MOST_STREAM_OBSTACLES, Deviation, Observation, StreamObstacle, StreamUpdate
from guidefield.messages.values import ORIGIN, Vector3
from guidefield.prove.tables import ARITHMETIC, parts_in_world, rounding_of
from guidefield.read_only import ReadOnly, read_only
from guidefield.scene import obstacle as obstacles
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.obstacle_message import put_at
from guidefield.scene.scene import Scene
from guidefield.stream.commit import ClosedSurface, SeenObstacles
from guidefield.stream.shapes import StreamShape, read_only_views, shape_of

HALF_SPACE_TURNS = "a half-space that turns sweeps everything: `largest_angular_speed` must be 0"

HALF_SPACE_MAY_TURN = "a half-space that turns sweeps everything: `assume.angular_speed` must be 0 where there is one"

HALF_SPACE_SEEN_TURNING = "a half-space that turns sweeps everything: its `angular_velocity` must be 0"


@dataclass
class TrackedObstacle:
    """An obstacle of a stream."""

    declared: StreamObstacle
    shape: StreamShape
    warnings: tuple[str, ...] = ()
    seen: Observation | None = None  # its last observation; None: not yet, or gone
    gone: bool = False
    written: bool = False

    @property
    def name(self) -> str:
        """Its name."""
        return self.declared.obstacle.name


@dataclass(frozen=True)
class Assumption:
    """The assumption on the motion of obstacles."""

    # largest deviation of velocities from the observed ones; None: largest speeds hold, whatever was observed
    deviation: Deviation | None
    min_clearance: float  # the distance kept beyond that [m]
    clock_error: float  # largest error of times of observations [s]


@dataclass(frozen=True, eq=False)
class DriftingObstacles(ReadOnly):
    """The moving obstacles as boxes, for planning."""

    boxes: np.ndarray  # rounded boxes that stand for them, shape (k, 16) [m, world], as `StreamShape.boxes`
    drifts: np.ndarray  # the observed velocity of each, shape (k, 3) [m/s]
    rates: np.ndarray  # speed at which each grows for the judge, shape (k,) [m/s]
    margins: np.ndarray  # distance that the judge keeps beyond that, shape (k,) [m]

    def after(self, time: float) -> np.ndarray:
        """The boxes after a time [s], shape (k, 16)."""
        boxes = self.boxes.copy()
        boxes[:, [3, 7, 11]] += time * self.drifts
        return boxes


@dataclass(eq=False)
class Obstacles:
    """All obstacles of a stream, those of its scene first; `commit.SeenObstacles` counts them so."""

    scene: Scene
    assumption: Assumption
    pairs: Callable[[str], np.ndarray]  # whether each moving body must not touch an obstacle of a name, shape (m,)
    origin: Vector3 = ORIGIN  # point of the world that the scene is seen from [m]; observations are of the world
    known: dict[str, TrackedObstacle] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._resting = parts_in_world(self.scene)
        self._remade = True
        self._met_changed = True

    def prepare(self, declared: StreamObstacle, path: str, links: Iterable[str]) -> TrackedObstacle:
        """Build a shape for `take`, without taking it.

        Raises:
            SceneInvalid: if it can't be used, or the name is taken.
        """
        message = declared.obstacle
        if message.name in self.scene.names or message.name in set(links):
            what = "an obstacle of the scene" if message.name in self.scene.names else "a link"
            raise SceneInvalid(
                f"`{path}.obstacle.name`: {message.name!r} is the name of {what}: give it another",
                obstacle=message.name,
                path=f"{path}.obstacle.name",
            )
        try:
            built = obstacles.build(in_its_frame(message), 0)
        except SceneInvalid as error:
            field = error.details["path"].removeprefix("$.obstacles[0]")
            details = {**error.details, "path": f"{path}.obstacle{field}"}
            raise SceneInvalid(f"`{path}.obstacle`: {error.message}", **details) from None
        shape = shape_of(built)
        if shape.endless and declared.largest_angular_speed > 0.0:
            raise SceneInvalid(f"`{path}`: {HALF_SPACE_TURNS}", obstacle=message.name, path=path)
        deviation = self.assumption.deviation
        if shape.endless and deviation is not None and deviation.angular_speed > 0.0:
            raise SceneInvalid(f"`{path}`: {HALF_SPACE_MAY_TURN}", obstacle=message.name, path=path)
        return TrackedObstacle(declared, shape, built.warnings)

    def require(self, declared: Sequence[TrackedObstacle], update: StreamUpdate) -> None:
        """Refuse an update that can't be taken as a whole.

        Raises:
            RequestTooLarge: if too many are known then, and too few of them are gone.
            UnknownObject: if an obstacle isn't declared.
            MalformedRequest: if an observation is of the future, or has a half-space turn where that counts.
        """
        shapes = {one.name: one.shape for one in declared}
        added = [index for index, one in enumerate(declared) if one.name not in self.known]
        gone = sum(one.gone and one.name not in shapes for one in self.known.values())
        if len(added) > (room := MOST_STREAM_OBSTACLES - len(self.known) + gone):
            path = f"$.declare[{added[room]}]"
            raise RequestTooLarge(
                f"`{path}`: a stream knows {MOST_STREAM_OBSTACLES} obstacles at most, and none of these is gone",
                path=path,
                limit=MOST_STREAM_OBSTACLES,
            )
        for index, name in enumerate(update.gone):
            if name not in self.known and name not in shapes:
                path = f"$.gone[{index}]"
                raise UnknownObject(f"`{path}`: no obstacle {name!r} is declared", object=name, path=path)
        for index, seen in enumerate(update.obstacles):
            if seen.name not in self.known and seen.name not in shapes:
                path, known = f"$.obstacles[{index}].name", list(self.known)
                raise UnknownObject(
                    f"`{path}`: no obstacle {seen.name!r} is declared; declared are {', '.join(known) or 'none'}",
                    object=seen.name,
                    available=known,
                    path=path,
                )
            if seen.time > update.time:
                path = f"$.obstacles[{index}].time"
                raise MalformedRequest(
                    f"`{path}` must not be after the update's `time` ({update.time} s), got {seen.time} s", path=path
                )
            if self.assumption.deviation is not None and any(seen.angular_velocity):
                shape = shapes[seen.name] if seen.name in shapes else self.known[seen.name].shape
                if shape.endless:
                    path = f"$.obstacles[{index}].angular_velocity"
                    raise MalformedRequest(f"`{path}`: {HALF_SPACE_SEEN_TURNING}", object=seen.name, path=path)

    def take(self, prepared: TrackedObstacle) -> None:
        """Take a shape, in place of the one of the same name; one that is gone is forgotten for it, if need be."""
        before = self.known.get(prepared.name)
        if before is None and len(self.known) >= MOST_STREAM_OBSTACLES:
            del self.known[next(name for name, one in self.known.items() if one.gone)]
        prepared.seen = None if before is None else before.seen
        self.known[prepared.name] = prepared
        self._remade = True

    def observe(self, seen: Observation) -> bool:
        """Take an observation, unless a later one is known; return whether its obstacle wasn't there before."""
        one = self.known[seen.name]
        if one.seen is not None and seen.time < one.seen.time:
            return False
        fresh = one.seen is None
        one.seen, one.gone, one.written = seen, False, False
        self._met_changed |= fresh
        return fresh

    def lose(self, name: str) -> None:
        """Note that a declared obstacle is gone."""
        one = self.known[name]
        self._met_changed |= one.seen is not None
        one.seen, one.gone = None, True

    @property
    def oldest(self) -> float:
        """Time of the oldest observation that counts [s]; infinite without any."""
        return min((one.seen.time for one in self.known.values() if one.seen is not None), default=np.inf)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Harmless peculiarities of shapes; each names its obstacle."""
        return tuple(warning for one in self.known.values() for warning in one.warnings)

    @property
    def names(self) -> list[str]:
        """Names in the judge's order."""
        return [*self.scene.names, *self.known]

    def see(self, reserve: float) -> SeenObstacles:
        """The observed obstacles, also with what they may cover in a reserved time [s]; the same arrays each time."""
        self._bring_up_to_date()
        np.add(self._movers.margins, reserve * self._movers.growths, out=self._reserved)
        return self._seen

    def _bring_up_to_date(self) -> None:
        if self._remade:
            self._remake()
        if self._met_changed:
            self._meet()
        self._write()

    def _remake(self) -> None:
        known, table, resting = list(self.known.values()), PartsTable(), len(self.scene.obstacles)
        table.add_parts(self._resting.parts)
        shapes = [one.shape for one in known]
        roots = np.array([*self._resting.roots.tolist(), *(table.add_parts(one.parts) for one in shapes)], np.int64)
        boxes, count = obstacle_boxes(self.scene).tables, len(known)
        axes, centres, halves = (
            np.concatenate([getattr(boxes, name), *(getattr(one.own, name) for one in shapes)])
            for name in ("axes", "centres", "halves")
        )
        movers_of = np.concatenate([np.full(resting, -1), np.arange(count)])
        boxes = boxes._replace(axes=axes, centres=centres, halves=halves)
        self._bodies = ObstacleBodies(boxes, roots, table.tables(), np.zeros(3), movers_of)
        self._error = rounding_of(self._bodies.parts) + ARITHMETIC * float(np.abs(boxes.nodes).max(initial=0.0))
        # each goes on from its last observed place, for ever
        endless = np.array([one.endless for one in shapes], np.int64)
        twists, speeds = np.zeros((2 * count, 6)), np.zeros(2 * count)
        times, poses = np.zeros(2 * count), np.zeros((2 * count, 12))
        margins, growths, since, self._reserved = (np.zeros(count) for _ in range(4))
        begins = 2 * np.arange(count + 1)
        self._movers = MovingObstacles(begins, times, poses, twists, speeds, endless, margins, growths, since)
        turns = self.assumption.deviation is not None
        self._reaches = np.array(
            [one.shape.reach if turns or one.declared.largest_angular_speed else 0.0 for one in known]
        )
        self._declared = np.array(
            [(d.largest_speed, d.largest_angular_speed, d.uncertainty) for d in (one.declared for one in known)]
        ).reshape(-1, 3)
        self._boxes = np.concatenate([np.empty((0, 16)), *(one.shape.boxes for one in known)])
        self._boxes_of = np.repeat(np.arange(len(known)), [len(one.shape.boxes) for one in known]).astype(np.int64)
        for one in known:
            one.written = False
        self._remade, self._met_changed = False, True

    def _meet(self) -> None:
        self._there = np.array([one.seen is not None for one in self.known.values()], bool)
        resting, boxes = len(self.scene.obstacles), obstacle_boxes(self.scene).tables
        apart = np.concatenate([boxes.apart, resting + np.flatnonzero(self._there)])
        bodies = self._bodies._replace(boxes=self._bodies.boxes._replace(apart=apart))
        meets = np.array([self.pairs(name) for name in self.names], bool)
        moving = read_only_views(self._movers)
        left_out = np.flatnonzero(~meets.T.ravel())
        read_only(left_out)
        closed = [ClosedSurface(k, solid_of_obstacle(one), place) for k, one, place in self._surfaces()]
        self._seen = SeenObstacles(
            read_only_views(bodies._replace(boxes=read_only_views(bodies.boxes))),
            moving,
            read_only_views(moving._replace(margins=self._reserved)),
            left_out,
            tuple(one for one in closed if one.solid.surfaces),
            self._error,
        )
        self._placed: np.ndarray | None = None
        self._met_changed = False

    def _surfaces(self) -> Iterator[tuple[int, Obstacle, np.ndarray | None]]:
        """Yield the present obstacles that count as surfaces, with their numbers; poses (3, 4) of those at rest."""
        for index, one in enumerate(self.scene.obstacles):
            if not one.convex and one.cloud is None:
                yield index, one, np.array(one.placement.homogeneous[:3])
        for index, known in enumerate(self.known.values(), len(self.scene.obstacles)):
            one = known.shape.obstacle
            if known.seen is not None and not one.convex and one.cloud is None:
                yield index, one, None

    def _write(self) -> None:
        """Write new observations into the arrays."""
        found = [
            (index, one.seen)
            for index, one in enumerate(self.known.values())
            if one.seen is not None and not one.written
        ]
        if not found:
            return
        seen = [one for _, one in found]
        which = np.array([index for index, _ in found])
        assumed, movers = self.assumption, self._movers
        speeds, turning, uncertain = self._declared[which].T
        velocities = np.zeros((len(seen), 3))
        if assumed.deviation is not None:
            velocities = np.array([one.velocity for one in seen])
            turns = np.linalg.norm([one.angular_velocity for one in seen], axis=1)
            speeds, turning = np.full(len(seen), assumed.deviation.speed), assumed.deviation.angular_speed + turns
        reaches = np.where(turning > 0.0, self._reaches[which], 0.0)  # a half-space reaches without end
        growths, predicted = speeds + turning * reaches, np.linalg.norm(velocities, axis=1)
        placements, times = [one.placement for one in seen], np.array([one.time for one in seen])
        places = frames(
            np.array([one.position for one in placements]) - self.origin,
            np.array([one.quaternion_xyzw for one in placements]),
        )
        movers.poses[2 * which] = movers.poses[2 * which + 1] = places
        movers.times[2 * which], movers.times[2 * which + 1] = times, np.inf
        movers.twists[2 * which, :3], movers.speeds[2 * which] = velocities, predicted
        movers.margins[which] = uncertain + (growths + predicted) * assumed.clock_error
        movers.growths[which], movers.since[which] = growths, times
        for one in self.known.values():
            one.written = True
        self._placed = None

    def boxes(self, times: Iterable[float]) -> np.ndarray:
        """Rounded boxes of the observed obstacles where they are predicted at some times [s], shape (k, 16)."""
        self._bring_up_to_date()
        kept = self._there[self._boxes_of]
        if not kept.any():
            return np.empty((0, 16))
        if self._placed is None:
            of = self._boxes_of[kept]
            seen = [one.seen for one in self.known.values()]
            speeds = np.array([(0.0,) * 3 if one is None else one.velocity for one in seen])
            self._placed = _placed_at(self._boxes[kept], self._movers.poses[2 * of])
            self._drifts, self._since = speeds[of], self._movers.since[of]
        rows = []
        for time in times:
            moved = self._placed.copy()
            moved[:, [3, 7, 11]] += (time - self._since)[:, None] * self._drifts
            rows.append(moved)
        return np.concatenate(rows)

    def drifting(self, now: float) -> DriftingObstacles:
        """The observed obstacles from a time on [s], for planning."""
        boxes = self.boxes([now])
        if not len(boxes):
            return DriftingObstacles(boxes, np.empty((0, 3)), np.empty(0), np.empty(0))
        of, movers = self._boxes_of[self._there[self._boxes_of]], self._movers
        return DriftingObstacles(
            boxes, self._drifts.copy(), movers.growths[of], movers.margins[of] + self.assumption.min_clearance
        )


def in_its_frame(message: messages.Obstacle) -> messages.Obstacle:
    """The message of an obstacle in its own frame: at the origin, where it has a placement of its own."""
    return put_at(message, pin.SE3.Identity()) if hasattr(message, "position") else message


def _placed_at(boxes: np.ndarray, poses: np.ndarray) -> np.ndarray:
    placed = boxes.copy()
    outer, inner = poses.reshape(-1, 3, 4), boxes[:, :12].reshape(-1, 3, 4)
    there = np.einsum("kij,kjn->kin", outer[:, :, :3], inner)
    there[:, :, 3] += outer[:, :, 3]
    placed[:, :12] = there.reshape(-1, 12)
    return placed
