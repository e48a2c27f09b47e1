"""The reply to a plan request, and its parts, which the reply to a certify request shares.

Names, meanings and defaults of fields are the wire. Docstrings of messages are in docs/wire.schema.json: after a
change, `tools/wire_page`. Accuracies that they promise are constants of `prove/search.py`, `planner/quality.py` and
`planner/task`.
"""

from __future__ import annotations

from typing import Any

from guidefield.messages.execution import ExecutionFigures, export_reply
from guidefield.messages.scene import GuidePlane
from guidefield.messages.values import Reply

Rows = list[list[float]]


class Outcome(Reply):
    """The outcome of a run.

    Attributes:
        code: Of `errors.Status`.
        name: Its name.
        message: One sentence to act on.
        details: The values of that sentence: of a motion beyond a joint's limits `joint`, `value`, `limits` and
            `excess` [rad or m], and the `configuration` there.
    """

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class Trajectory(Reply):
    """A motion in time: knots of the certified curve, cubic between them, or samples of it at `sample_rate`.

    Attributes:
        times: Increasing from 0 [s].
        positions: A row for each time in the columns of `position_names` [rad, m, or entries of a quaternion].
        velocities: A row for each time in the columns of `velocity_names` [rad/s or m/s].
        accelerations: The same [rad/s^2 or m/s^2].
    """

    times: list[float]
    positions: Rows
    velocities: Rows
    accelerations: Rows


class Stage(Reply):
    """One stage of a plan.

    Attributes:
        name: Its name.
        outcome: Its outcome.
        seconds: Its duration [s].
        plane: Index of its guide plane, if any.
    """

    name: str
    outcome: str
    seconds: float
    plane: int | None = None


class ClearanceFigures(Reply):
    """Distance between moving links and obstacles along the trajectory; null without such a pair.

    The smallest distances are over the whole curve, between samples too, and while the robot waits: no distance is
    smaller by more than 0.1 mm. If time was too short to find one (the search ends with `allowed_planning_time`, and
    takes at least a hundredth of a second), a warning says so, and the figure is a lower bound, or null if none is
    known.

    Attributes:
        minimum: The smallest [m].
        mean: Over the motion, sampled [m].
        inner: The smallest without 0.3 rad, or 0.3 m times the size of the robot (of a base at least 1), of the path at
            each end [m].
        ends: The smaller of those at start and goal [m].
        pair: Link and obstacle at the smallest distance.
        time: Time of the smallest distance [s].
    """

    minimum: float | None
    mean: float | None
    inner: float | None
    ends: float | None
    pair: list[str] | None
    time: float | None


class SelfClearance(Reply):
    """Distance of the robot to itself along the trajectory; null without such a pair.

    Attributes:
        minimum: The smallest, as in `ClearanceFigures` [m].
        pair: The two links.
    """

    minimum: float | None
    pair: list[str] | None


class CertificateFigures(Reply):
    """The certificate of a plan.

    Attributes:
        collision_free: Whether the covered motion is free, and keeps the requested clearance and the joints' position
            limits, between samples too.
        method: The method.
        covers: The covered part, such as trajectory, path, or nothing.
        evaluations: The number of evaluated configurations.
    """

    collision_free: bool
    method: str
    covers: str
    evaluations: int


class CartesianUse(Reply):
    """The largest speed and acceleration of what a request limits in space, between samples too.

    Attributes:
        frame: The frame; null of a link.
        link: The link, or the held object; null of a frame.
        speed: The largest speed that was found: nothing is faster anywhere by more than 0.1 % [m/s].
        speed_limit: Its limit [m/s].
        speed_time: The time of the largest speed [s].
        acceleration: The largest acceleration; null where it isn't limited, and of straight pieces, whose velocity
            jumps [m/s^2].
        acceleration_limit: Its limit; null for none [m/s^2].
        acceleration_time: The time of the largest acceleration; null as there [s].
    """

    frame: str | None
    link: str | None
    speed: float
    speed_limit: float
    speed_time: float
    acceleration: float | None = None
    acceleration_limit: float | None = None
    acceleration_time: float | None = None


class EffortUse(Reply):
    """The largest torque or force that drives a joint along a motion.

    Attributes:
        joint: The joint, as a column of velocities.
        effort: The largest that was found [N m or N].
        time: Its time [s].
        limit: The request's limit, else the robot's own; null for none [N m or N].
        share: Of the limit, which nothing exceeds between samples either: `effort` is less by 1 % of the limit at most.
    """

    joint: str
    effort: float
    time: float
    limit: float | None = None
    share: float | None = None


class EffortFigures(Reply):
    """Torques along a motion, of rigid bodies under gravity, with what is held; without friction and rotors.

    Attributes:
        reason: Why there are none, in words, as where a robot has no inertia; null where there are.
        joints: The largest of each joint.
        energy: Mechanical work of all joints, taken or given back alike [J].
    """

    reason: str | None = None
    joints: list[EffortUse] = []
    energy: float | None = None


class Metrics(Reply):
    """Length, duration and smoothness of a motion.

    Attributes:
        joint_path_length: In the joints' coordinates [rad or m].
        tip_path_length: Of the tip's path [m].
        duration: [s].
        peak_jerk: The largest [rad/s^3 or m/s^3].
        smoothness: Bending energy of the path times its length, without unit; 0 for a straight one.
    """

    joint_path_length: float
    tip_path_length: float
    duration: float
    peak_jerk: float
    smoothness: float


class Timing(Reply):
    """Time by stage [s].

    `ends` checks start and goal, `relax` optimises the motion, `measure` computes the reply's figures and rows,
    `queue` is waiting.
    """

    queue: float = 0.0
    load: float = 0.0
    ends: float = 0.0
    connect: float = 0.0
    guide: float = 0.0
    relax: float = 0.0
    parameterize: float = 0.0
    certify: float = 0.0
    measure: float = 0.0
    total: float = 0.0


class Counters(Reply):
    """Counts of expensive operations.

    Attributes:
        iterations: Of trees, descents and the optimisation.
        potential_evaluations: Configurations at which the field on the robot was evaluated.
        collision_checks: Checked motions, and configurations of the certificate.
    """

    iterations: int = 0
    potential_evaluations: int = 0
    collision_checks: int = 0


class Permission(Reply):
    """The times between which a held object may touch an obstacle: the certificate leaves the pair out.

    Attributes:
        object: The held object.
        obstacle: The obstacle that it may touch.
        begin: Begin [s].
        end: End [s].
    """

    object: str
    obstacle: str
    begin: float
    end: float


class StepFigures(Reply):
    """One step of a sequence.

    Attributes:
        begin: Its begin [s].
        end: Its end, pause included [s]; the time at which it passes its goal if it doesn't stop.
        held: Names of the objects held during the step.
        attached: Object that is picked up at its end.
        detached: Object that is put down at its end.
        clearance: From obstacles, except those that a held object may touch; null if nothing moves.
        self_clearance: Of the robot from itself; null if nothing moves.
        certificate: The certificate of the trajectory between `begin` and `end`, with the held objects.
        permissions: Contacts that a held object may have during the step.
        passed: Distance from its goal at `end` if it doesn't stop: the larger of the tip's distance [m] and angle [rad]
            for a pose or relative goal, the largest of the joints [rad or m] for a goal of joints.
        cartesian: The largest speed of each frame and link that is limited during the step.
        effort: Torques during the step, with what is held; null if nothing moves.
    """

    begin: float
    end: float
    held: list[str]
    attached: str | None
    detached: str | None
    clearance: ClearanceFigures | None
    self_clearance: SelfClearance | None
    certificate: CertificateFigures
    permissions: list[Permission]
    passed: float | None = None
    cartesian: list[CartesianUse] = []
    effort: EffortFigures | None = None


class PlanReply(Reply):
    """The reply to a plan request, also if no motion was found.

    Look at `status` first. The motion is `trajectory`: the cubic Hermite curve through its times, positions and
    velocities is the curve that was certified.

    Attributes:
        run_id: Name of the run.
        status: The outcome.
        position_names: Columns of positions, such as panda_joint1, root_joint.x, ball.qw.
        velocity_names: Columns of velocities, in the tangent space.
        path: The planner's path, a row for each waypoint; the best partial motion if it failed.
        trajectory: The motion to execute; null if there is none.
        guide_planes: Those of the plan, derived ones included.
        stages: The stages, in order.
        clearance: From obstacles, along the trajectory; null if time was up before it was measured.
        self_clearance: Of the robot from itself; null as `clearance`.
        certificate: The certificate of the trajectory, or of the path if there is no trajectory.
        metrics: Of the trajectory.
        timing: Time by stage.
        counters: Numbers of operations.
        seed: The request's.
        planner: The request's.
        recording: Key or file of the recording, if there is one.
        warnings: Harmless peculiarities of the request.
        objective: The request's.
        steps: The steps of a sequence. If one failed, those before it; `path` is then the failed step's, and
            `status.details` has its number as `step`.
        proof: Key or file of the proof, if the request asks for one and there is one; else `warnings` says why not.
        execution: The rows to send to a controller, if the request has an `execution` and the motion is certified: the
            certificate and the clearances are those of the curve that it draws.
        cartesian: The largest speed of each frame and link that the request limits; in `steps` for a sequence.
        effort: Torques along the trajectory; in `steps` for a sequence, because they depend on the held object.

    Examples:
        >>> import guidefield
        >>> goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
        >>> reply = guidefield.answer({"robot": "ur5", "scene": "table", "goal": goal, "guide_planes": []})
        >>> reply.status.code == guidefield.Status.SUCCESS
        True
        >>> elbow = reply.position_names.index("elbow_joint")
        >>> [round(row[elbow], 3) for row in reply.trajectory.positions][-1]
        1.2
        >>> reply.clearance.pair, reply.trajectory.times[-1] == reply.metrics.duration
        (['shoulder_link', 'floor'], True)
    """

    run_id: str
    status: Outcome
    position_names: list[str]
    velocity_names: list[str]
    path: Rows
    trajectory: Trajectory | None
    guide_planes: list[GuidePlane]
    stages: list[Stage]
    clearance: ClearanceFigures | None
    self_clearance: SelfClearance | None
    certificate: CertificateFigures
    metrics: Metrics | None
    timing: Timing
    counters: Counters
    seed: int
    planner: str
    recording: str | None
    schema: int = 1
    warnings: list[str] = []
    objective: str = "balanced"
    steps: list[StepFigures] = []
    proof: str | None = None
    execution: ExecutionFigures | None = None
    cartesian: list[CartesianUse] = []
    effort: EffortFigures | None = None

    def export(self, kind: str) -> bytes:
        """Write the rows of `execution` as a file of a kind, "ros.json", "yaml", "script", "csv", "json" or "npz".

        Raises MalformedRequest if the motion isn't certified for what draws such a file.
        """
        return export_reply(self, kind)
