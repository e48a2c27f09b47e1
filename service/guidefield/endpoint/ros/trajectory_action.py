"""A client of a ros2_control controller's FollowJointTrajectory: it sends a certified trajectory, and watches it.

An action is three services and two topics below its name. Versions of its types differ in their hashes: the token of
the controller's service says which one it has. Zenoh's threads receive messages, the caller's handles them in order.

The robot's place on the certified curve is the point that is nearest to the controller's desired position, and not
before the last one: so no clocks are compared. The robot's distance from that point must be within the tolerance.
`guidefield execute` (`cli/executing.py`) uses it.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import queue
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from guidefield.endpoint.link import Distribution
from guidefield.endpoint.ros.node import client_config
from guidefield.endpoint.ros.rmw_zenoh import (
    GRAPH,
    MESSAGES,
    SERVICES,
    STORES,
    Attachment,
    Entity,
    Kind,
    Node,
    RemoteEntity,
    Types,
    Unreadable,
)
from guidefield.errors import GuidefieldError, MalformedRequest, NoService, TimedOut, UnknownObject, strip_source
from guidefield.messages.certify_reply import JointStates

ACTION = "control_msgs/action/FollowJointTrajectory"
STATE, CANCEL = "sensor_msgs/msg/JointState", "action_msgs/srv/CancelGoal"
SUFFIX = "/follow_joint_trajectory"  # of the action's name, behind the controller's
_TOLERANCE = "float64 position\nfloat64 velocity\nfloat64 acceleration"
_GOAL = """trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance"""
_POINTS = tuple(f"trajectory_msgs/{{}}JointTrajectoryPoint {{}}{name}" for name in ("desired", "actual", "error"))


@dataclass(frozen=True)
class Version:
    """The differences between versions of control_msgs."""

    effort: bool  # whether tolerances have a limit of effort
    index: bool  # whether feedback has indices, from 6.3 on


VERSIONS = tuple(Version(*each) for each in itertools.product((False, True), repeat=2))


@functools.cache
def action_types(version: Version) -> Types:
    """Return the types of a version."""
    effort = "\nfloat64 effort" if version.effort else ""
    messages = {
        **MESSAGES,
        "control_msgs/JointTolerance": f"string name\n{_TOLERANCE}{effort}",
        "control_msgs/JointComponentTolerance": f"string joint_name\nuint16 component\n{_TOLERANCE}",
    }
    feedback = ["std_msgs/Header header"]
    for kind, prefix in (("", ""), ("MultiDOF", "multi_dof_")):
        feedback.append(f"string[] {prefix}joint_names")
        feedback += [point.format(kind, prefix) for point in _POINTS]
        feedback += [f"int32 {prefix}index"] if version.index else []
    services = {
        **SERVICES,
        "action_msgs/CancelGoal": ("GoalInfo goal_info", "int8 return_code\nGoalInfo[] goals_canceling"),
    }
    action = (_GOAL, "int32 error_code\nstring error_string", "\n".join(feedback))
    return Types(STORES[Distribution.JAZZY], messages, services, {ACTION.replace("/action/", "/"): action})


RESULTS = {4: "succeeded", 5: "canceled", 6: "aborted"}
"""States in which a goal ends, of action_msgs/msg/GoalStatus."""
CODES = {
    -1: "the goal is invalid",
    -2: "its joints aren't the controller's",
    -3: "its time has passed",
    -4: "a joint left its path tolerance",
    -5: "a joint missed its goal tolerance",
}
"""Codes of a result."""

CANCEL_REFUSED, UNKNOWN_GOAL = 1, 2  # codes of action_msgs/srv/CancelGoal; with others it is canceling, or over
START_TOLERANCE = 0.01  # a robot that is farther from the first row isn't moved [rad or m] (docs/execution.md)
CHECK_INTERVAL_S = 0.05  # interval at which the caller checks for messages [s]
SEARCH_AHEAD_S = 0.5  # how far past the elapsed time the place is searched [s]: less loses it, more may skip a loop
CURVE_TOLERANCE = 1e-3
"""A controller whose desired position is farther from the curve follows another one, and is reported [rad or m].

It must stay far above `CHORD_TOLERANCE` of `cli/executing.py`, by which the curve is sampled; docs/execution.md tells
it.
"""


@dataclass(frozen=True, eq=False)
class MotionToExecute:
    """A certified trajectory, and samples of its curve."""

    joints: tuple[str, ...]
    message: Mapping[str, Any]  # JointTrajectory as plain data
    tolerance: Sequence[float]  # of each joint [rad or m]
    times: np.ndarray  # of close samples of the curve, shape (n,) [s]
    places: np.ndarray  # positions of the k joints then, shape (n, k) [rad or m]


@dataclass
class ExecutionOutcome:
    """The outcome of a motion."""

    states: JointStates  # measured positions; times begin on the curve's clock, and go on by the controller's
    ended: str = "silent"  # how the goal ended: succeeded, canceled, aborted, silent
    reason: str = ""
    # positions beyond the tolerance: time on the curve [s], joint, and distance [rad or m]
    violations: list[tuple[float, str, float]] = field(default_factory=list)
    off_curve: float = 0.0  # largest distance of a desired position from the curve [rad or m]

    @property
    def is_fine(self) -> bool:
        """Return whether it succeeded, within the tolerance."""
        return self.ended == "succeeded" and not self.violations


class ControllerClient:
    """A client of a controller that follows joint trajectories.

    Args:
        session: A Zenoh session that reaches the nodes.
        domain: ROS domain.
        name: Of the controller, with its namespace if it has one.
        patience: Longest time without an expected message [s].

    Raises:
        UnknownObject: if there is no such controller.
        MalformedRequest: if it speaks another version of the action.
    """

    def __init__(self, session: zenoh.Session, domain: int, name: str, patience: float = 5.0) -> None:
        self.name = name.strip("/").removesuffix(SUFFIX)
        self._session, self._domain, self._patience = session, domain, patience
        self._sender, self._numbers = os.urandom(16), itertools.count(1)
        self._heard: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        offered = self._find()
        self._sending = self._version_of(offered, f"{ACTION}_SendGoal", Kind.SERVICE, "send_goal")
        self._hearing = self._version_of(offered, f"{ACTION}_FeedbackMessage", Kind.PUBLISHER, "feedback")

    def follow(self, motion: MotionToExecute, say: Callable[[str], None]) -> ExecutionOutcome:
        """Have the controller follow a motion until it ends.

        An interrupt cancels it, and watches it to its end. Any other exception cancels it, even before the controller
        has accepted it.

        Args:
            motion: Begins where the robot is.
            say: Takes sentences about the progress.

        Raises:
            NoService: if the link is lost.
            TimedOut: if joint states, or the controller, aren't heard.
            MalformedRequest: if the robot isn't at the start, or the controller refuses, or tells of other joints.
        """
        watch = _Watch(motion)
        with self._listening():
            self._require_at_start(motion)
            goal_id, duration = os.urandom(16), float(motion.times[-1] - motion.times[0])
            is_accepted = True  # as far as is known
            try:
                is_accepted = self._send(motion, goal_id)
                if not is_accepted:
                    raise MalformedRequest(f"controller {self.name!r} refuses the motion", controller=self.name)
                say(f"{self.name} follows {duration:.3f} s")
                self._ask_result(goal_id, duration)
                self._watch(watch, say)
            except KeyboardInterrupt:
                say(self._cancel(goal_id))
                self._ask_result(goal_id, duration)  # no query for it may be under way yet
                self._watch(watch, say)
            except BaseException:  # nobody would watch what goes on moving
                if is_accepted:
                    self._cancel_unwatched(goal_id, say)
                raise
        return watch.outcome()

    def _find(self) -> list[RemoteEntity]:
        action, until, others = f"{self.name}{SUFFIX}/_action/", time.monotonic() + self._patience, set[str]()
        while True:
            tokens = [
                str(one.ok.key_expr) for one in self._session.liveliness().get(f"{GRAPH}/{self._domain}/**") if one.ok
            ]
            seen = [one for one in map(RemoteEntity.read, tokens) if one is not None]
            own = [one for one in seen if one.name.startswith(action)]
            if any(one.name == f"{action}send_goal" and one.kind == Kind.SERVICE.value for one in own):
                return own
            others |= {
                one.name.removesuffix(f"{SUFFIX}/_action/send_goal") for one in seen if one.name.endswith("send_goal")
            }
            if time.monotonic() > until:
                there = ", ".join(sorted(others)) or "none"
                raise UnknownObject(
                    f"no controller {self.name!r} follows joint trajectories in domain {self._domain};"
                    f" there are: {there}",
                    controller=self.name,
                    available=sorted(others),
                )
            time.sleep(CHECK_INTERVAL_S)

    def _version_of(self, offered: Sequence[RemoteEntity], type_name: str, kind: Kind, name: str) -> Types:
        whole = f"{self.name}{SUFFIX}/_action/{name}"
        hashes = [one.type_hash for one in offered if one.name == whole and one.kind == kind.value]
        for version in VERSIONS:
            if action_types(version).type_hash(type_name) in hashes:
                return action_types(version)
        raise MalformedRequest(
            f"controller {self.name!r} speaks another version of {type_name}"
            f" ({', '.join(one[:20] for one in hashes) or 'without a token'}…): none that is known here",
            controller=self.name,
        )

    def _entity(self, kind: Kind, name: str, type_name: str, types: Types) -> Entity:
        return Entity(kind, f"{self.name}{SUFFIX}/_action/{name}", type_name, types.type_hash(type_name))

    @contextlib.contextmanager
    def _listening(self) -> Iterator[None]:
        feedback = self._entity(Kind.SUBSCRIPTION, "feedback", f"{ACTION}_FeedbackMessage", self._hearing)
        states = Entity(Kind.SUBSCRIPTION, "joint_states", STATE, self._hearing.type_hash(STATE))
        node = Node(self._domain, str(self._session.zid()), "guidefield_execute")
        with contextlib.ExitStack() as declared:
            tokens = [node.token(), node.token_of(1, feedback), node.token_of(2, states)]
            for token in tokens:
                declared.callback(self._session.liveliness().declare_token(token).undeclare)
            for entity, what in ((feedback, "feedback"), (states, "states")):
                hear = functools.partial(self._hear, what, entity.type_name)
                declared.callback(self._session.declare_subscriber(entity.key(self._domain), hear).undeclare)
            yield

    def _hear(self, what: str, type_name: str, sample: zenoh.Sample) -> None:
        with contextlib.suppress(Unreadable):
            self._heard.put((what, self._hearing.read(sample.payload.to_bytes(), type_name)))

    def _require_at_start(self, motion: MotionToExecute) -> None:
        until = time.monotonic() + self._patience
        while (left := until - time.monotonic()) > 0.0:
            with contextlib.suppress(queue.Empty):
                what, message = self._heard.get(timeout=left)
                if what != "states":
                    continue
                named = dict(zip(message.name, message.position, strict=False))  # some nodes send velocities alone
                if not all(joint in named for joint in motion.joints):
                    continue
                for joint, first in zip(motion.joints, motion.places[0].tolist(), strict=True):
                    place = float(named[joint])
                    if not abs(place - first) <= START_TOLERANCE:  # neither is what is no number
                        raise MalformedRequest(
                            f"the robot isn't at the start of the motion: joint {joint!r} is at {place:.6g}, not at"
                            f" {first:.6g}",
                            joint=joint,
                        )
                return
        raise TimedOut(
            f"no joint states of {', '.join(motion.joints)} were heard within {self._patience:g} s: whether the robot"
            " is at the start isn't known"
        )

    def _request(
        self, name: str, type_name: str, timeout: float, fields: Mapping[str, Any], *take: Callable[[zenoh.Reply], None]
    ) -> Any:
        """Send a request; return an iterator over its replies, or None if they are taken.

        Raises NoService if the link is lost.
        """
        types = self._sending
        payload = types.write(types.new(f"{type_name}_Request", **fields), f"{type_name}_Request")
        try:
            return self._session.get(
                self._entity(Kind.CLIENT, name, type_name, types).key(self._domain),
                *take,
                payload=payload,
                attachment=Attachment(next(self._numbers), self._sender).write(),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
            )
        except zenoh.ZError as error:
            unreached = f"controller {self.name!r} isn't reached: {strip_source(error)}"
            raise NoService(unreached, controller=self.name) from None

    def _ask(self, name: str, type_name: str, fields: Mapping[str, Any]) -> Any:
        for reply in self._request(name, type_name, self._patience, fields):
            if reply.ok is not None:
                try:
                    return self._sending.read(reply.ok.payload.to_bytes(), f"{type_name}_Response")
                except Unreadable as error:
                    unreadable = f"controller {self.name!r} answers {name} with what can't be read: {error}"
                    raise MalformedRequest(unreadable, controller=self.name) from None
        return None

    def _send(self, motion: MotionToExecute, goal_id: bytes) -> bool:
        tolerances = [
            {"name": joint, "position": value}
            for joint, value in zip(motion.joints, motion.tolerance, strict=True)
            if value > 0.0
        ]
        goal = {"trajectory": motion.message, "path_tolerance": tolerances}
        request = {"goal_id": _uuid(goal_id), "goal": goal}
        answer = self._ask("send_goal", f"{ACTION}_SendGoal", request)
        if answer is None:
            raise TimedOut(f"controller {self.name!r} is silent: it didn't answer the goal within {self._patience:g} s")
        return bool(answer.accepted)

    def _ask_result(self, goal_id: bytes, duration: float) -> None:
        name = f"{ACTION}_GetResult"

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                with contextlib.suppress(Unreadable):
                    self._heard.put(("result", self._sending.read(reply.ok.payload.to_bytes(), f"{name}_Response")))

        timeout = 10.0 * (duration + self._patience)
        self._request("get_result", name, timeout, {"goal_id": _uuid(goal_id)}, take)

    def _cancel(self, goal_id: bytes) -> str:
        """Have the controller cancel a motion, whose goal it may accept only now; return a sentence about it.

        Raises:
            TimedOut: if it doesn't answer, or knows no such motion all the while.
            NoService, MalformedRequest: as `_ask`.
        """
        request, until = {"goal_info": {"goal_id": _uuid(goal_id)}}, time.monotonic() + self._patience
        while True:
            answer = self._ask("cancel_goal", CANCEL, request)
            if answer is None:
                raise TimedOut(
                    f"controller {self.name!r} is silent: it didn't answer that the motion is to be canceled"
                )
            if answer.return_code != UNKNOWN_GOAL:
                return "canceling" if answer.return_code != CANCEL_REFUSED else "the controller refuses to cancel"
            if time.monotonic() > until:
                raise TimedOut(f"controller {self.name!r} knows no such motion to cancel: it hasn't accepted it yet")
            time.sleep(CHECK_INTERVAL_S)

    def _cancel_unwatched(self, goal_id: bytes, say: Callable[[str], None]) -> None:
        """Cancel a motion that isn't watched any more; say so if that fails."""
        try:
            self._cancel(goal_id)
        except GuidefieldError as error:
            with contextlib.suppress(OSError):
                say(f"the motion couldn't be canceled, and the robot may be moving: {error}")

    def _watch(self, watch: _Watch, say: Callable[[str], None]) -> None:
        heard = time.monotonic()
        while time.monotonic() - heard < self._patience:
            with contextlib.suppress(queue.Empty):
                what, message = self._heard.get(timeout=CHECK_INTERVAL_S)
                if what == "states":
                    continue
                heard = time.monotonic()
                if what == "result":
                    watch.end(message)
                    return
                if (sentence := watch.take(message.feedback)) is not None:
                    say(sentence)
        raise TimedOut(
            f"controller {self.name!r} is silent: neither feedback nor a result within {self._patience:g} s; the robot"
            f" was last {watch.where()}",
            controller=self.name,
        )


@contextlib.contextmanager
def controller_at(endpoint: str, domain: int, name: str, patience: float) -> Iterator[ControllerClient]:
    """Find a controller through the router at a Zenoh endpoint, as `ControllerClient`; NoService if there is none."""
    try:
        session = zenoh.open(client_config(endpoint))
    except zenoh.ZError as error:
        raise NoService(f"nothing is reached at {endpoint!r}: {strip_source(error)}", endpoint=endpoint) from None
    with session:
        yield ControllerClient(session, domain, name, patience)


class _Watch:
    """Follows the robot along the curve by the controller's feedback."""

    def __init__(self, motion: MotionToExecute) -> None:
        self._motion = motion
        self._at = 0.0  # place on the curve: index of a sample, and the share of the way to the next one
        self._first: tuple[float, float] | None = None  # of the first feedback: time on the curve, and its stamp [s]
        self._times, self._rows = list[float](), list[list[float]]()
        self._outcome, self._is_outside, self._told_curve = ExecutionOutcome(JointStates((), (), ())), False, False

    def take(self, feedback: Any) -> str | None:
        motion, names = self._motion, list(feedback.joint_names)
        if lacking := next((joint for joint in motion.joints if joint not in names), None):
            raise MalformedRequest(
                f"the controller's feedback has no joint {lacking!r}; it has {', '.join(names)}", joint=lacking
            )
        order = [names.index(joint) for joint in motion.joints]
        rows = [np.asarray(one.positions) for one in (feedback.desired, feedback.actual)]
        if any(len(one) != len(names) or not np.isfinite(one[order]).all() for one in rows):
            raise MalformedRequest(
                "the controller's feedback isn't a finite position of each joint, desired and actual"
            )
        desired, actual = (one[order] for one in rows)
        stamp = feedback.header.stamp.sec + 1e-9 * feedback.header.stamp.nanosec or time.monotonic()
        place, off = self._go_on(desired, stamp)
        there = float(np.interp(self._at, np.arange(len(motion.times)), motion.times))
        self._first = self._first or (there, stamp)
        self._times.append(self._first[0] + stamp - self._first[1])
        self._rows.append(actual.tolist())
        self._outcome.off_curve = max(self._outcome.off_curve, off)
        if off > CURVE_TOLERANCE and not self._told_curve:
            self._told_curve = True
            return f"the controller draws another curve than the certified one: {off:.3g} from it at {there:.3f} s"
        return self._look(np.abs(actual - place), there)

    def _look(self, apart: np.ndarray, there: float) -> str | None:
        motion = self._motion
        beyond = apart - np.array(motion.tolerance)
        worst, was_outside = int(np.argmax(beyond)), self._is_outside
        self._is_outside = bool(beyond[worst] > 1e-9)
        if not self._is_outside:
            return f"back within the tolerance at {there:.3f} s" if was_outside else None
        self._outcome.violations.append((there, motion.joints[worst], float(apart[worst])))
        if was_outside:
            return None
        return (
            f"left the tolerance at {there:.3f} s: {motion.joints[worst]} is {apart[worst]:.3g} from the certified"
            f" curve, {motion.tolerance[worst]:.3g} allowed"
        )

    def _go_on(self, desired: np.ndarray, stamp: float) -> tuple[np.ndarray, float]:
        """Move on to the place on the curve nearest to the desired one; return it, shape (k,), and its distance.

        The search ends `SEARCH_AHEAD_S` beyond the time since the last feedback.
        """
        times, places, first = self._motion.times, self._motion.places, int(self._at)
        passed = 0.0 if self._first is None else self._first[0] + stamp - self._first[1] - self._times[-1]
        last = int(np.searchsorted(times, times[first] + max(passed, 0.0) + SEARCH_AHEAD_S, side="right"))
        if first >= len(places) - 1:
            return places[-1], float(np.abs(desired - places[-1]).max())
        near = places[first : max(last, first + 1) + 1]
        begins, steps = near[:-1], np.diff(near, axis=0)
        squares, along = (np.einsum("ij,ij->i", one, steps) for one in (steps, desired - begins))
        shares = np.clip(np.divide(along, squares, out=np.zeros_like(along), where=squares > 0.0), 0.0, 1.0)
        shares[0] = max(shares[0], self._at - first)
        on_curve = begins + shares[:, None] * steps
        off = np.abs(on_curve - desired).max(axis=1)
        nearest = int(np.argmin(off))
        self._at = first + nearest + float(shares[nearest])
        return on_curve[nearest], float(off[nearest])

    def end(self, result: Any) -> None:
        self._outcome.ended = RESULTS.get(int(result.status), f"in state {result.status}")
        code = CODES.get(int(result.result.error_code), "")
        self._outcome.reason = ": ".join(one for one in (code, str(result.result.error_string)) if one)

    def where(self) -> str:
        if not self._times:
            return "never heard of"
        pairs = zip(self._motion.joints, self._rows[-1], strict=True)
        return f"at {', '.join(f'{joint} {value:.4g}' for joint, value in pairs)}"

    def outcome(self) -> ExecutionOutcome:
        self._outcome.states = JointStates(self._motion.joints, self._times, self._rows)
        return self._outcome


def _uuid(value: bytes) -> dict[str, Any]:
    return {"uuid": np.frombuffer(value, np.uint8)}
