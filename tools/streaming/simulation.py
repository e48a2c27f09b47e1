"""A robot that executes a stream's pieces among obstacles that move, judged from outside.

The judge samples densely, with plain Pinocchio and Coal, the motion that the messages describe: it knows no kernel and
no commit. A client takes a piece that follows what it executes and is there before it begins; else the old one is
executed to its end.
"""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import coal
import numpy as np
import pinocchio as pin

from guidefield.messages.streams import Observation, Piece, StreamGoal, StreamUpdate
from guidefield.messages.values import Placement
from guidefield.stream.stream import CertifiedStream
from streaming.movers import Mover, radius_of

STILL = 1e-9
"""Slower is at rest [rad/s or m/s]."""

KEPT = 16
"""So many observations of each obstacle are remembered for updates that bring old ones."""


@dataclass
class Faults:
    """Faults between client and service.

    Attributes:
        lost: Share of updates that are lost.
        dropped: Share of pieces that come too late.
        delayed: Observations are so much older than their updates at most [s].
        clock: Times of observations are off by at most this [s].
        silent: Beginning and end of a silence [s].
        epoch: What the client's clock shows at the beginning [s]; the larger, the coarser.
        drift: Times of observations go wrong by so much a second, from one end of what `clock` allows [s/s].
        astray: So far is each joint from its piece at most [rad or m].
    """

    lost: float = 0.0
    dropped: float = 0.0
    delayed: float = 0.0
    clock: float = 0.0
    silent: tuple[float, float] = (np.inf, np.inf)
    epoch: float = 0.0
    drift: float = 0.0
    astray: float = 0.0


@dataclass
class Outcome:
    """The outcome of a run.

    Attributes:
        reached: When the robot stood at its goal [s]; infinite: it didn't.
        at_speed: Contacts while it moved: time, link, obstacle.
        at_rest: Contacts while it stood.
        cycles: CPU time of each update [s].
        pieces: Pieces that were taken.
        late: Pieces that came too late.
        stood: Time that it stood before the goal [s].
        excess: By how much the largest velocity, acceleration and jerk were beyond their limits, as shares.
        reasons: How often there was no piece, by reason.
        lasted: How long the run was [s].
        moved: How long the robot moved [s].
    """

    reached: float = np.inf
    at_speed: list[tuple[float, str, str]] = field(default_factory=list)
    at_rest: list[tuple[float, str, str]] = field(default_factory=list)
    cycles: list[float] = field(default_factory=list)
    pieces: int = 0
    late: int = 0
    stood: float = 0.0
    excess: np.ndarray = field(default_factory=lambda: np.full(3, -1.0))
    reasons: dict[str, int] = field(default_factory=dict)
    lasted: float = 0.0
    moved: float = 0.0

    @property
    def success(self) -> bool:
        """Return whether the goal was reached without a contact."""
        return bool(np.isfinite(self.reached)) and not self.at_speed and not self.at_rest


class Executed:
    """The motion that a client executes.

    Args:
        z: Where it stands, shape (nv,).
    """

    def __init__(self, z: np.ndarray) -> None:
        self.number, self.stops, self.reaches_goal = 0, -np.inf, False
        self._times = np.array([0.0])
        self._q, self._v, self._a = z[None], np.zeros((1, len(z))), np.zeros((1, len(z)))
        self._waiting: list[Piece] = []

    def take(self, piece: Piece) -> None:
        """Have a piece executed from its beginning on."""
        self._waiting.append(piece)

    def at(self, now: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration at a time [s], each of shape (nv,)."""
        while self._waiting and self._waiting[0].begins <= now:
            piece = self._waiting.pop(0)
            if piece.follows == self.number:
                self.number, self.stops, self.reaches_goal = piece.number, piece.stops, piece.reaches_goal
                told = piece.trajectory
                self._times = np.array(told.times)
                self._q, self._v, self._a = (
                    np.array(rows) for rows in (told.positions, told.velocities, told.accelerations)
                )
        k = int(np.searchsorted(self._times, now, side="right")) - 1
        if k + 1 >= len(self._times):
            return self._q[-1], np.zeros(self._q.shape[1]), np.zeros(self._q.shape[1])
        k = max(k, 0)
        s, span = now - self._times[k], self._times[k + 1] - self._times[k]
        jerk = (self._a[k + 1] - self._a[k]) / span
        q, v, a = self._q[k], self._v[k], self._a[k]
        return q + s * (v + s * (a / 2.0 + s * jerk / 6.0)), v + s * (a + s * jerk / 2.0), a + s * jerk


class Bodies:
    """A robot's bodies for plain Pinocchio and Coal.

    Args:
        stream: Whose robot.
        own: Whether its own pairs are looked at.
    """

    def __init__(self, stream: CertifiedStream, own: bool = True) -> None:
        group = stream.group
        self.model, self.geometry = group.model, group.geometry
        self.data, self.placed = self.model.createData(), self.geometry.createData()
        self._group = group
        self.joints = [shape.parentJoint for shape in self.geometry.geometryObjects]
        self.own = [(p.first, p.second) for p in self.geometry.collisionPairs] if own else []
        self.own = [(a, b) for a, b in self.own if self.joints[a] != self.joints[b]]
        self._first, self._second = np.array(self.own, np.int64).reshape(-1, 2).T
        self.allowed = set(stream.request.allowed_collisions)
        self.radii = np.array([radius_of(shape.geometry) for shape in self.geometry.geometryObjects])
        self._boxes = [_box_of(shape.geometry) for shape in self.geometry.geometryObjects]

    def place(self, z: np.ndarray) -> np.ndarray:
        """Put them at coordinates z (nv,); where their frames are, shape (n, 3) [m]."""
        q = self._group.expand_from_local(z)
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.placed, q)
        return self._places()

    def _places(self) -> np.ndarray:
        return np.array([placement.translation for placement in self.placed.oMg])

    def name(self, body: int) -> str:
        """The link of a body."""
        return self._group.robot.link_of_geometry(body)

    def touches(self, body: int, shape: coal.CollisionGeometry, place: coal.Transform3s) -> bool:
        """Return whether a body touches a shape somewhere; the box about it is asked first."""
        here = self.placed.oMg[body]
        own = self.geometry.geometryObjects[body].geometry
        there = coal.Transform3s(here.rotation, here.translation)
        box, inside = self._boxes[body]
        return _collide(box, there * inside, shape, place) and _collide(own, there, shape, place)

    def touching_own(self) -> tuple[str, str] | None:
        """A pair of its own that touches, or None."""
        places = self._places()
        far = np.linalg.norm(places[self._first] - places[self._second], axis=1)
        for index in np.flatnonzero(far < self.radii[self._first] + self.radii[self._second]).tolist():
            a, b = self.own[index]
            here = self.placed.oMg[b]
            shape = self.geometry.geometryObjects[b].geometry
            if self.touches(a, shape, coal.Transform3s(here.rotation, here.translation)):
                return self.name(a), self.name(b)
        return None


def _box_of(shape: coal.CollisionGeometry) -> tuple[coal.Box, coal.Transform3s]:
    """The box along a shape's axes that holds it, and where that is in the shape's frame [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    return coal.Box(*(high - low)), coal.Transform3s(np.eye(3), 0.5 * (low + high))


def _collide(one: coal.CollisionGeometry, here: object, other: coal.CollisionGeometry, there: object) -> bool:
    return bool(coal.collide(one, here, other, there, coal.CollisionRequest(), coal.CollisionResult()))


def simulate(
    stream: CertifiedStream,
    movers: Sequence[Mover],
    resting: Sequence[tuple[str, coal.CollisionGeometry, coal.Transform3s]],
    duration: float,
    rng: np.random.Generator,
    faults: Faults | None = None,
    *,
    own: bool = True,
    charged: bool = True,
    dt: float = 0.004,
    deviating: bool = False,
    to_the_end: bool = False,
    goals: Sequence[tuple[float, StreamGoal]] = (),
) -> Outcome:
    """Run a stream for a while, and judge what its robot does.

    Args:
        stream: The stream.
        movers: What moves.
        resting: Name, shape and place of what rests.
        duration: How long, at most [s].
        rng: For what goes wrong.
        faults: That.
        own: Whether the robot may touch itself.
        charged: Whether the CPU time of an update counts on the simulated clock: a piece that is there too late isn't
            taken.
        dt: Between two samples [s].
        deviating: Whether observations have velocities.
        to_the_end: Whether the run goes on once the goal is reached, or something was touched.
        goals: When there is another goal [s], and which.
    """
    faults = faults or Faults()
    outcome, bodies = Outcome(), Bodies(stream, own)
    request = stream.request
    executed = Executed(stream.executing.ends.copy())
    limits = _limits(stream)
    steps, every = round(duration / dt), max(1, round(request.period / dt))
    seen: deque[tuple[float, list[Observation]]] = deque(maxlen=KEPT)
    gc.unfreeze()  # of the run before
    gc.collect()
    gc.freeze()  # what is there by now isn't collected within a cycle, as in a service
    for step in range(steps):
        now = step * dt
        clock = faults.epoch + now
        z, v, a = executed.at(clock)
        z = z + faults.astray * np.sin(40.0 * z + np.arange(len(z)))  # who stands stays where it is
        places = bodies.place(z)
        moving = bool(np.abs(v).max() > STILL)
        outcome.lasted, outcome.moved = now + dt, outcome.moved + dt * moving
        while goals and goals[0][0] <= now:
            stream.aim_for(goals[0][1])
            goals = goals[1:]
        _look(outcome, bodies, places, movers, resting, now, moving, step)
        rounded = 4.0 * np.spacing(clock)  # so late or soon may what is looked at be
        shares = np.abs(np.stack([v, a], axis=1)) - rounded * limits[:, 1:]
        outcome.excess[:2] = np.maximum(outcome.excess[:2], (shares / limits[:, :2]).max(axis=0) - 1.0)
        if executed.reaches_goal and clock >= executed.stops:
            outcome.reached = min(outcome.reached, now)
            if not to_the_end:
                break
        elif not moving and clock >= executed.stops:
            outcome.stood += dt
        if (outcome.at_speed or outcome.at_rest) and not to_the_end:
            break
        if step % every == 0:
            seen.append((clock, [_observed(mover, clock, deviating) for mover in movers]))
            _exchange(stream, executed, seen, clock, z, rng, faults, charged, outcome, limits)
        for mover in movers:
            mover.step(now, dt, places)
    return outcome


def _limits(stream: CertifiedStream) -> np.ndarray:
    """Velocity, acceleration and jerk limits, shape (nv, 3): the stream's, and the jerks that were asked for."""
    limits: np.ndarray = stream._opened.bounds.rates.copy()
    names = stream.group.position_names
    for joint, asked in stream.request.limits.items():
        if asked.jerk is not None:
            limits[names.index(joint), 2] = asked.jerk
    return limits


def _observed(mover: Mover, now: float, deviating: bool) -> Observation:
    velocity = tuple(mover.velocity.tolist()) if deviating else (0.0, 0.0, 0.0)
    return Observation(mover.name, now, Placement(tuple(mover.position.tolist()), mover.quaternion), velocity)


def _exchange(stream, executed, seen, now, z, rng, faults, charged, outcome, limits) -> None:
    """Send an update, unless it is lost, and take the piece, unless it is late."""
    if faults.silent[0] <= now - faults.epoch < faults.silent[1] or rng.random() < faults.lost:
        return
    old = now - rng.uniform(0.0, faults.delayed)
    observed = [one for one in seen if one[0] <= old] or [seen[0]]
    at, obstacles = observed[-1]
    if faults.clock > 0.0:
        off = rng.uniform(-faults.clock, faults.clock)
        if faults.drift:
            gone = faults.drift * (at - faults.epoch)
            off = np.clip(gone - np.sign(faults.drift) * faults.clock, -faults.clock, faults.clock)
        off = min(float(off), now - at)
        obstacles = [Observation(o.name, o.time + off, o.placement, o.velocity) for o in obstacles]
    names = stream.group.position_names
    update = StreamUpdate(now, obstacles, dict(zip(names, z.tolist(), strict=True)), executed.number)
    began = time.thread_time()  # ways are planned in another thread, as in a service
    answer = stream.update(update)
    spent = time.thread_time() - began
    outcome.cycles.append(spent)
    if not isinstance(answer, Piece):
        outcome.reasons[answer.reason] = outcome.reasons.get(answer.reason, 0) + 1
        return
    late = charged and now + spent > answer.begins
    if late or rng.random() < faults.dropped:
        outcome.late += 1
        return
    outcome.pieces += 1
    told = answer.trajectory
    spans = np.diff(told.times) + 4.0 * np.spacing(told.times[1:])  # times are rounded, and knots as close as 1e-9 s
    jerks = np.diff(told.accelerations, axis=0) / spans[:, None]
    outcome.excess[2] = max(outcome.excess[2], float((np.abs(jerks) / limits[:, 2]).max()) - 1.0)
    executed.take(answer)


def _look(outcome, bodies, places, movers, resting, now, moving, step) -> None:
    """Look for contacts."""
    found = outcome.at_speed if moving else outcome.at_rest
    if movers:
        centres, reaches = np.array([one.position for one in movers]), np.array([one.radius for one in movers])
        far = np.linalg.norm(centres[:, None] - places, axis=2)
        for which, body in np.argwhere(far < reaches[:, None] + bodies.radii).tolist():
            mover = movers[which]
            place = coal.Transform3s(mover.rotation, mover.position)
            if bodies.joints[body] and bodies.touches(body, mover.shape, place):
                found.append((now, bodies.name(body), mover.name))
    if step % 4 == 0:  # what rests doesn't come by itself
        for name, shape, place in resting:
            for body in range(len(bodies.joints)):
                looked_at = bodies.joints[body] and (bodies.name(body), name) not in bodies.allowed
                if looked_at and bodies.touches(body, shape, place):
                    found.append((now, bodies.name(body), name))
        pair = bodies.touching_own()
        if pair is not None:
            found.append((now, *pair))
