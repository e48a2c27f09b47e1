"""The answer to a plan request, and what it is made of."""

from __future__ import annotations

from typing import Any

from guidefield.messages.scene import GuidePlane
from guidefield.messages.values import Reply

Rows = list[list[float]]


class Outcome(Reply):
    """The end of a plan.

    Attributes:
        code: Of `errors.Status`.
        name: Its name.
        message: One sentence to act on.
        details: The values that it speaks about: of a motion that is beyond a joint's limits `joint`, `value`, `limits`
            and `excess` [rad or m], and the `configuration` there.
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
        name: What it was.
        outcome: How it ended.
        seconds: How long it took [s].
        plane: Index of the guide plane that it was about, if any.
    """

    name: str
    outcome: str
    seconds: float
    plane: int | None = None


class ClearanceFigures(Reply):
    """Distance between moving links and obstacles along the trajectory, as they then stand; null without such a pair.

    The smallest distances are over the whole curve, between any samples too, and while the robot waits: no distance is
    smaller by more than 0.1 mm. Where there was no time to find one (it is looked for until `allowed_planning_time` is
    up, and for a hundredth of a second at least), a warning says so, and what stands there is what is kept at least
    instead, null if nothing is known.

    Attributes:
        minimum: The smallest [m].
        mean: Over the motion, sampled [m].
        inner: The smallest without 0.3 rad or m of the way at each end [m].
        ends: The smaller of those at start and goal [m].
        pair: Link and obstacle where it is smallest.
        time: When it is smallest [s].
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
        collision_free: Whether what it covers is free, keeps the clearance asked for and the joints' position limits,
            between samples too.
        method: How it was judged.
        covers: What was judged.
        evaluations: With how many evaluations of configurations.
    """

    collision_free: bool
    method: str
    covers: str
    evaluations: int


class Metrics(Reply):
    """Length, duration and smoothness of a motion.

    Attributes:
        joint_path_length: In the joints' coordinates [rad or m].
        tip_path_length: Of the tip's way [m].
        duration: [s].
        peak_jerk: The largest [rad/s^3 or m/s^3].
        smoothness: Bending energy of the way times its length, without unit; 0 for a straight one.
    """

    joint_path_length: float
    tip_path_length: float
    duration: float
    peak_jerk: float
    smoothness: float


class Timing(Reply):
    """Time by stage [s].

    `ends` judges start and goal, `relax` optimises the motion, `measure` takes the reply's figures and writes its rows,
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
        collision_checks: Motions, and configurations of the certificate, that were judged.
    """

    iterations: int = 0
    potential_evaluations: int = 0
    collision_checks: int = 0


class Permission(Reply):
    """The times between which a held object may touch an obstacle: the certificate leaves the pair out.

    Attributes:
        object: What is held.
        obstacle: What it may touch.
        begin: Since when [s].
        end: Until when [s].
    """

    object: str
    obstacle: str
    begin: float
    end: float


class StepFigures(Reply):
    """One step of a sequence.

    Attributes:
        begin: When it begins [s].
        end: When it ends, its pause included [s]; when it passes its goal where it doesn't stop.
        held: Names of the objects that are held meanwhile.
        attached: What is picked up at its end.
        detached: What is put down at its end.
        clearance: From obstacles meanwhile, but for what a held object may touch; null where nothing moves.
        self_clearance: Of the robot from itself; the same.
        certificate: The judgement of the trajectory between `begin` and `end`, with what is held then.
        permissions: What a held object may touch meanwhile.
        passed: How far from its goal it passes at `end` where it doesn't stop: the tip's place [m] or its turn [rad],
            whichever is more, for a pose or relative goal; the farthest joint [rad or m] for one of joints.
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


class PlanReply(Reply):
    """The answer to a plan request, an honest "no" included.

    Look at `status` first. The motion is `trajectory`: the cubic Hermite curve through its times, positions and
    velocities is the curve that was certified.

    Attributes:
        run_id: Name of the run.
        status: How it ended.
        position_names: Columns of positions, such as panda_joint1, root_joint.x, ball.qw.
        velocity_names: Columns of velocities, in the tangent space.
        path: What the planner found, a row for each waypoint; the best partial motion where it failed.
        trajectory: What the robot would execute; null where there is none.
        guide_planes: Those of the plan, derived ones included.
        stages: What was done, in order.
        clearance: From obstacles, along the trajectory; null where time was up before it was measured.
        self_clearance: Of the robot from itself; null as `clearance`.
        certificate: The judgement of the trajectory, or of the path where there is no trajectory.
        metrics: Of the trajectory.
        timing: Time by stage.
        counters: Numbers of operations.
        seed: The request's.
        planner: The request's.
        recording: Key or file of the recording, if there is one.
        schema: Version of this message.
        warnings: Harmless peculiarities of the request.
        objective: The request's.
        steps: Of a sequence: each step in time. Of one that failed, those before the step that failed; `path` is then
            that step's, and `status.details` has its number as `step`.
        proof: Key or file of the proof, if the request asks for one and there is one; else `warnings` says why not.

    Example:
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
