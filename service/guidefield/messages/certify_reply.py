"""The reply to a certify request; sentences about verdicts; the judgement of an executed plan's joint states.

Names, meanings and defaults of fields are the wire. Docstrings of messages are in docs/wire.schema.json: after a
change, `tools/wire_page`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.certify_request import CertifyRequest, GivenTrajectory
from guidefield.messages.execution import ExecutionFigures, MotionDeviation, export_reply
from guidefield.messages.plan_reply import (
    CartesianUse,
    CertificateFigures,
    ClearanceFigures,
    Counters,
    EffortFigures,
    Outcome,
    PlanReply,
    SelfClearance,
    Timing,
)
from guidefield.messages.plan_request import PlanRequest
from guidefield.messages.values import Reply


class Along(Reply):
    """A place along a motion as it was given.

    Attributes:
        row: Index of the row before it plus a fraction of the step to the next: 12.25 is a quarter of the path from row
            12 to row 13; in a trajectory a quarter of the time.
        time: When [s]; null where the motion has no times.
    """

    row: float
    time: float | None


class Place(Along):
    """The place at which a motion was refused.

    Attributes:
        configuration: Joint values there, by the names of `position_names`.
    """

    configuration: dict[str, float]


class MotionCertificate(CertificateFigures):
    """The certificate of a given motion.

    Attributes:
        reason: "free", or why it is refused: "contact", "too close", "beyond limits", "violates a path constraint",
            "undecided" or "stopped".
        free_until: The place up to which the motion is certified from its beginning; its end if it is free.
        pair: The two bodies that were refused; null if the motion is free, or no pair is the cause.
        place: The place of the refusal; null if the motion is free.
    """

    reason: str
    free_until: Along
    pair: list[str] | None = None
    place: Place | None = None


class MotionClearance(ClearanceFigures):
    """`ClearanceFigures` along a given motion.

    Attributes:
        row: Place of the smallest clearance, as in `Along`; null without such a pair.
    """

    row: float | None = None


class LimitUse(Reply):
    """The largest share of a limit that a motion uses, exactly, between its rows too.

    Attributes:
        share: 1 is the limit: of a position the distance from the middle of its range, divided by half the range; of a
            rate its magnitude, divided by the largest one. Null if nothing is limited, or the curve has no such rate.
        joint: The joint.
        row: The place, as in `Along`.
        time: The time [s].
        steps: Whether the rate of the next lower order jumps there, so that no limit is kept: then the share is null.
    """

    share: float | None = None
    joint: str | None = None
    row: float | None = None
    time: float | None = None
    steps: bool = False


class LimitShares(Reply):
    """The largest share of each limit that a motion uses.

    Attributes:
        position: Of the joints' ranges.
        velocity: Null without times.
        acceleration: Null without times, and of straight pieces, whose velocity jumps.
        jerk: The same, and where the request limits none.
    """

    position: LimitUse
    velocity: LimitUse
    acceleration: LimitUse
    jerk: LimitUse


class CertifyReply(Reply):
    """The verdict on a motion.

    Look at `status` first: SUCCESS if the motion is free, keeps the request's conditions and is within all limits;
    INVALID_MOTION_PLAN if it doesn't, and `certificate` or `limits` says why; TIMED_OUT or PREEMPTED if the work ended
    before the verdict, with the part that is free.

    Attributes:
        run_id: Name of the run.
        status: The verdict.
        curve: The curve that was certified: "hermite", cubic through knots with velocities; "spline", cubic and twice
            continuously differentiable through samples; "linear", straight pieces; "quintic", of degree 5; "steps":
            anything between one command and the next.
        position_names: Columns of configurations, in the robot's order.
        velocity_names: Columns of rates.
        certificate: Whether the motion is free, and up to which place.
        clearance: From obstacles, along the motion; null if time was up before it was measured.
        self_clearance: Of the robot from itself; null as `clearance`.
        limits: The largest share of each limit that is used.
        timing: Time by stage.
        counters: Numbers of operations.
        recording: Key or file of the recording, if there is one.
        warnings: Harmless peculiarities of the request.
        proof: Key or file of the proof, if the request asks for one and there is one; else `warnings` says why not.
        execution: The rows of the curve that was judged, if the request has an `execution`.
        deviation: Of the motion from the one that was `planned`, if the request has one.
        cartesian: The largest speed of each frame and link that the request limits.
        effort: Torques along the motion; null of what has no accelerations.

    Examples:
        >>> import guidefield
        >>> names = ["shoulder_pan_joint", "elbow_joint"]
        >>> request = {"type": "certify", "robot": "ur5", "scene": "table", "position_names": names}
        >>> reply = guidefield.answer({**request, "path": [[0.0, 1.0], [0.4, 1.2]]})
        >>> reply.status.name, reply.curve, reply.certificate.free_until.row
        ('SUCCESS', 'linear', 1.0)
    """

    run_id: str
    status: Outcome
    curve: str
    position_names: list[str]
    velocity_names: list[str]
    certificate: MotionCertificate
    clearance: MotionClearance | None
    self_clearance: SelfClearance | None
    limits: LimitShares
    timing: Timing
    counters: Counters
    recording: str | None
    schema: int = 1
    warnings: list[str] = []
    proof: str | None = None
    execution: ExecutionFigures | None = None
    deviation: MotionDeviation | None = None
    cartesian: list[CartesianUse] = []
    effort: EffortFigures | None = None

    def export(self, kind: str) -> bytes:
        """Write the rows of `execution` as a file of a kind, "ros.json", "yaml", "script", "csv", "json" or "npz".

        Raises MalformedRequest if the motion isn't certified for what draws such a file.
        """
        return export_reply(self, kind)


def describe_place(row: float, time: float | None) -> str:
    """Name a place along a given motion: its row, and its time if it has one."""
    return f"row {row:.6g}" if time is None else f"{time:.6g} s (row {row:.6g})"


def describe_speed(use: CartesianUse) -> str:
    """Say in words how fast a frame or link is at most."""
    return f"{use.frame or use.link} reaches {use.speed:.4g} m/s of {use.speed_limit:g}, at {use.speed_time:.2f} s"


def describe_effort(effort: EffortFigures) -> str | None:
    """Say in words which joint takes the largest share of its torque; None where no torque with a limit is reported."""
    limited = [use for use in effort.joints if use.share is not None]
    if not limited:
        return None
    use = max(limited, key=lambda use: use.share or 0.0)
    return (
        f"{use.joint} takes {use.effort:.4g} N m, {100.0 * (use.share or 0.0):.1f} % of its limit, at {use.time:.2f} s"
    )


def describe_certificate(reply: PlanReply) -> str:
    """Say in words what a plan's certificate covers, and whether that is free."""
    covers = reply.certificate.covers
    if covers == "nothing":
        return "nothing was judged"
    judged = f"the {covers}"
    if covers == "path":
        judged = "the start alone" if len(reply.path) == 1 else "the motion as far as it got"
    return f"{'free' if reply.certificate.collision_free else 'not certified'}: {judged}"


SHARED_FIELDS = (
    "robot",
    "scene",
    "robot_placement",
    "start",
    "min_clearance",
    "attached_objects",
    "allowed_collisions",
    "path_constraints",
    "limits",
    "cartesian_limits",
    "max_velocity_scaling_factor",
    "max_acceleration_scaling_factor",
    "leave_start_contact",
)
"""Fields of a plan request that describe its motion, and that a certify request has, too.

`judgement_of`, but for `leave_start_contact`, and the command line to judge a stored run again, copy them alone.
"""


class JointStates(NamedTuple):
    """Positions of joints, in the order of time.

    Attributes:
        joints: Their names.
        times: When [s].
        positions: A row for each time, in the order of the joints [rad or m].
    """

    joints: Sequence[str]
    times: Sequence[float]
    positions: Sequence[Sequence[float]]


def judgement_of(
    request: PlanRequest, reply: PlanReply, states: JointStates, begin: float = 0.0, allowed_time: float = 60.0
) -> CertifyRequest:
    """Make the request that judges what a robot executed of a plan, straight between its states; torques aren't judged.

    Args:
        states: Of all joints of the plan, in any order; other joints don't count.
        begin: When the motion began, on the clock of the states [s]; states before it don't count.
        allowed_time: For the judgement [s].

    Raises:
        UnknownObject: if the plan has no motion.
        MalformedRequest: if a joint of the plan has no state or two columns, a state isn't one finite value for each
            joint, two states are in the wrong order, there are none since the motion began, or the plan picks up or
            puts down.
    """
    planned = reply.trajectory
    if planned is None:
        raise UnknownObject(f"run {reply.run_id!r} has no motion: {reply.status.name}", run_id=reply.run_id)
    if any(step.attach is not None or step.detach is not None for step in request.steps):
        raise MalformedRequest("what is executed is judged against a plan that carries the same things all along")
    for joint in reply.position_names:
        if joint not in states.joints:
            raise MalformedRequest(
                f"the joint states have no joint {joint!r}, which the plan moves; they have {', '.join(states.joints)}",
                joint=joint,
                available=[*states.joints],
            )
        if states.joints.count(joint) > 1:
            raise MalformedRequest(f"the joint states have joint {joint!r} more than once", joint=joint)
    columns = [states.joints.index(joint) for joint in reply.position_names]
    if len(states.times) != len(states.positions):
        raise MalformedRequest(f"the joint states have {len(states.times)} times and {len(states.positions)} rows")
    times, positions = list[float](), list[list[float]]()
    for index, (time, row) in enumerate(zip(states.times, states.positions, strict=True)):
        _require_state(index, time, row, columns, states.joints)
        if index and time < states.times[index - 1]:
            raise MalformedRequest(
                f"the joint states are in the wrong order: state {index} is of {time:.9g} s, the one before of"
                f" {states.times[index - 1]:.9g} s",
                row=index,
            )
        if time >= begin and (not times or time - begin > times[-1]):  # several nodes may send states of one time
            times.append(time - begin)
            positions.append([row[column] for column in columns])
    if not times:
        last = f"the last one is of {states.times[-1]:.9g} s" if len(states.times) else "there are none"
        raise MalformedRequest(f"no joint state is of {begin:.9g} s or later: {last}")
    shared = {name: getattr(request, name) for name in SHARED_FIELDS if name != "leave_start_contact"}
    shared["limits"] = {name: msgspec.structs.replace(one, effort=None) for name, one in request.limits.items()}
    plan = GivenTrajectory(positions=planned.positions, times=planned.times, velocities=planned.velocities)
    try:
        executed = GivenTrajectory(positions=positions, times=times)
    except ValueError as error:
        raise MalformedRequest(f"the joint states, since the motion began, in the plan's columns: {error}") from None
    return CertifyRequest(
        **shared,
        tip=request.tip,
        position_names=reply.position_names,
        trajectory=executed,
        interpolation="linear",
        planned=plan,
        allowed_time=allowed_time,
        recording=request.recording,
    )


def _require_state(
    index: int, time: float, row: Sequence[float], columns: Sequence[int], joints: Sequence[str]
) -> None:
    if len(row) != len(joints):
        raise MalformedRequest(f"joint state {index} has {len(row)} values for {len(joints)} joints", row=index)
    if not math.isfinite(time):
        raise MalformedRequest(f"joint state {index} is of {time} s, which is no time", row=index)
    for column in columns:
        if not math.isfinite(row[column]):
            raise MalformedRequest(
                f"joint state {index}, of {time:.9g} s, has joint {joints[column]!r} at {row[column]}",
                row=index,
                joint=joints[column],
            )
