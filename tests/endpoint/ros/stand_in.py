"""A stand-in of ros2_control's JointTrajectoryController, with its own interpolation: an action server in plain Python.

It knows keys, attachments and messages as rmw_zenoh has them, written apart from the room that is tested but for the
types. Each piece between two points is linear, cubic or quintic, by what both have.
"""

from __future__ import annotations

import contextlib
import functools
import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from guidefield.endpoint.ros.trajectory_action import VERSIONS, Version, action_types

ACTION = "control_msgs/action/FollowJointTrajectory"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
UNKNOWN_GOAL = 2  # code of an answer to who cancels what isn't accepted
STEP = 0.01  # from one state to the next, on the controller's clock [s]


def stamp_of(seconds: float) -> dict[str, int]:
    whole = int(seconds)
    return {"sec": whole, "nanosec": round((seconds - whole) * 1e9) % 10**9}


def interpolated(points: list[Any], at: float) -> np.ndarray:
    """Where a controller has its joints at a time since the start [s]."""
    times = np.array([one.time_from_start.sec + 1e-9 * one.time_from_start.nanosec for one in points])
    if at >= times[-1]:
        return np.array(points[-1].positions)
    k = max(int(np.searchsorted(times, at, side="right")) - 1, 0)
    first, second, span = points[k], points[k + 1], times[k + 1] - times[k]
    derivatives = [("positions",), ("positions", "velocities"), ("positions", "velocities", "accelerations")]
    fields = next(some for some in derivatives[::-1] if all(len(getattr(p, f)) for p in (first, second) for f in some))
    count = len(fields)
    rows = []
    for t in (0.0, span):
        for order in range(count):
            powers = np.arange(2 * count)
            factors = np.array([np.prod(np.arange(p - order + 1, p + 1.0)) if p >= order else 0.0 for p in powers])
            rows.append(factors * np.array([t ** max(p - order, 0) for p in powers]))
    ends = np.array([getattr(point, name) for point in (first, second) for name in fields])
    coefficients = np.linalg.solve(np.array(rows), ends)
    return np.array((at - times[k]) ** np.arange(2 * count) @ coefficients)


@dataclass
class StandIn:
    """The controller: what it does wrong, if anything, is set before it gets a goal."""

    session: zenoh.Session
    joints: list[str]
    start: np.ndarray
    version: Version = VERSIONS[0]
    name: str = "arm/joint_trajectory_controller"
    domain: int = 0
    speed: float = 1.0  # how fast its clock runs, at most
    bend: Callable[[float], float] = lambda _: 0.0  # how far its robot is from where it desires it, by the time [s]
    accepts: bool = True
    late: float = 0.0  # how long it takes to accept a goal [s]
    unreadable: bool = False  # whether its answer to a goal is no message
    on_goal: Callable[[], None] = lambda: None  # called once it has a goal, before it accepts it
    silent_after: float = np.inf  # when it says no more [s]
    told: list[str] = field(default_factory=lambda: [])  # joints of its feedback; none: its own
    goals: list[Any] = field(default_factory=lambda: [])
    executed: list[tuple[float, np.ndarray]] = field(default_factory=lambda: [])
    canceled: threading.Event = field(default_factory=threading.Event)
    moves: threading.Event = field(default_factory=threading.Event)
    _status: int = 0
    _code: int = 0
    _ended: threading.Event = field(default_factory=threading.Event)
    _over: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=lambda: [])

    def key(self, name: str, type_name: str) -> str:
        package, kind, own = type_name.split("/")
        return f"{self.domain}/{name}/{package}::{kind}::dds_::{own}_/{self.types.type_hash(type_name)}"

    @property
    def types(self) -> Any:
        return action_types(self.version)

    @contextlib.contextmanager
    def there(self) -> Iterator[StandIn]:
        """Offer the action, and tell joint states, until the block ends."""
        base = f"{self.name}/follow_joint_trajectory/_action"
        services = {
            "send_goal": (f"{ACTION}_SendGoal", self._take_goal),
            "get_result": (f"{ACTION}_GetResult", self._give_result),
            "cancel_goal": ("action_msgs/srv/CancelGoal", self._cancel),
        }
        zid, declared = self.session.zid(), []
        for number, (name, (type_name, answer)) in enumerate(services.items(), 1):
            key = self.key(f"{base}/{name}", type_name)
            serve = functools.partial(self._start, key, type_name, answer)
            declared.append(self.session.declare_queryable(key, serve, complete=True))
            declared.append(self._token(zid, number, "SS", f"{base}/{name}", type_name))
        self._feedback = self.key(f"{base}/feedback", f"{ACTION}_FeedbackMessage")
        declared.append(self._token(zid, 9, "MP", f"{base}/feedback", f"{ACTION}_FeedbackMessage"))
        telling = threading.Thread(target=self._tell_states)
        telling.start()
        try:
            yield self
        finally:
            self._over.set()
            self._ended.set()
            telling.join()
            for one in declared:
                one.undeclare()
            for thread in self._threads:
                thread.join()

    def _token(self, zid: Any, number: int, kind: str, name: str, type_name: str) -> Any:
        package, of, own = type_name.split("/")
        on_zenoh = f"{package}::{of}::dds_::{own}_/{self.types.type_hash(type_name)}"
        own_name = "%" + name.replace("/", "%")
        return self.session.liveliness().declare_token(
            f"@ros2_lv/{self.domain}/{zid}/0/{number}/{kind}/%/%/controller_manager/{own_name}/{on_zenoh}/::,10:,:,:,,"
        )

    def _put(self, key: str, type_name: str, **fields: Any) -> None:
        payload = self.types.write(self.types.new(type_name, **fields), type_name)
        attached = struct.pack("<qq", 1, time.time_ns()) + bytes([16]) + bytes(16)
        self.session.put(key, payload, attachment=attached)

    def _tell_states(self) -> None:
        key = self.key("joint_states", "sensor_msgs/msg/JointState")
        while not self._over.wait(0.05):
            place = self.executed[-1][1] if self.executed else self.start
            self._put(key, "sensor_msgs/msg/JointState", name=["finger", *self.joints], position=[0.0, *place])

    def _start(self, key: str, type_name: str, answer: Callable[[Any], dict[str, Any]], query: zenoh.Query) -> None:
        thread = threading.Thread(target=self._serve, args=(query, key, type_name, answer))
        thread.start()
        self._threads.append(thread)  # from then on it can be waited for

    def _serve(self, query: zenoh.Query, key: str, type_name: str, answer: Callable[[Any], dict[str, Any]]) -> None:
        with query:
            asked = self.types.read(query.payload.to_bytes(), f"{type_name}_Request")
            fields = answer(asked)
            if self._over.is_set():
                return
            response = self.types.write(self.types.new(f"{type_name}_Response", **fields), f"{type_name}_Response")
            if self.unreadable and type_name.endswith("_SendGoal"):
                response = b"\xff"
            query.reply(key, response, attachment=query.attachment.to_bytes())

    def _take_goal(self, asked: Any) -> dict[str, Any]:
        self.goals.append(asked.goal)
        self.on_goal()
        if self.accepts and not self._over.wait(self.late):
            self.moves.set()
            thread = threading.Thread(target=self._execute, args=(asked.goal_id, asked.goal))
            thread.start()
            self._threads.append(thread)
        return {"accepted": self.accepts}

    def _execute(self, goal_id: Any, goal: Any) -> None:
        points = goal.trajectory.points
        order = [goal.trajectory.joint_names.index(joint) for joint in self.joints]
        end = points[-1].time_from_start.sec + 1e-9 * points[-1].time_from_start.nanosec
        now = 0.0
        while now < end and not self._over.is_set():
            if self.canceled.is_set():
                self._status = CANCELED
                self._ended.set()
                return
            now = min(now + STEP * self.speed, end)
            desired = interpolated(points, now)[order]
            actual = desired + self.bend(now)
            self.executed.append((now, actual))
            if now < self.silent_after:
                self._tell(goal_id, now, desired, actual)
            time.sleep(STEP)
        if now < self.silent_after:
            self._status = SUCCEEDED if self._code == 0 else ABORTED
            self._ended.set()

    def _tell(self, goal_id: Any, now: float, desired: np.ndarray, actual: np.ndarray) -> None:
        point = {"desired": desired, "actual": actual, "error": desired - actual}
        feedback = {
            "header": {"stamp": stamp_of(1000.0 + now)},
            "joint_names": self.told or self.joints,
            **{name: {"positions": values} for name, values in point.items()},
        }
        self._put(self._feedback, f"{ACTION}_FeedbackMessage", goal_id={"uuid": goal_id.uuid}, feedback=feedback)

    def _give_result(self, _asked: Any) -> dict[str, Any]:
        self._ended.wait()
        return {"status": self._status, "result": {"error_code": self._code, "error_string": ""}}

    def _cancel(self, _asked: Any) -> dict[str, Any]:
        if not self.moves.is_set():
            return {"return_code": UNKNOWN_GOAL}
        self.canceled.set()
        return {"return_code": 0}


@contextlib.contextmanager
def controller_listening(endpoint: str, joints: list[str], start: list[float], **how: Any) -> Iterator[StandIn]:
    """A stand-in in a session that listens at an endpoint."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session, StandIn(session, joints, np.array(start), **how).there() as there:
        yield there
