"""Streams: what a client opens, what it sees and sends, and the pieces of motion that it gets.

All times are the client's clock, in seconds from an origin of its choice; they are compared with no other clock.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import AllowedCollisions, AttachedObjects, JointLimits
from guidefield.messages.goals import JointSetGoal, JointsGoal, PoseGoal, Positions, require_finite_positions
from guidefield.messages.references import RobotReference, SceneReference, settle_scene
from guidefield.messages.replies import ErrorReply
from guidefield.messages.scene import Obstacle
from guidefield.messages.values import (
    ORIGIN,
    Message,
    Name,
    NonNegative,
    Placement,
    Positive,
    Reply,
    RunId,
    Vector3,
    require_finite,
    require_finite_number,
)

MOST_OBSTACLES = 10_000
"""Most obstacles that a stream knows at once."""

MOST_UPDATE_BYTES = 16 << 20
"""The longest update that a service looks at [bytes]."""

Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]

StreamGoal = JointsGoal | JointSetGoal | PoseGoal


class StreamObstacle(Message):
    """A shape that may be observed, and what is known of how it moves.

    Attributes:
        obstacle: Its shape. A box, cylinder, capsule, sphere or mesh is placed by observations alone; of a polygon, a
            half-space and a point cloud they place the frame that its numbers are in.
        largest_speed: Of the origin of its frame [m/s].
        largest_angular_speed: At which it turns about that origin [rad/s].
        uncertainty: How far any point of it may be from where it is observed [m].
    """

    obstacle: Obstacle
    largest_speed: NonNegative
    largest_angular_speed: NonNegative = 0.0
    uncertainty: NonNegative = 0.0

    def __post_init__(self) -> None:
        for field in ("largest_speed", "largest_angular_speed", "uncertainty"):
            require_finite_number(field, getattr(self, field))
        if self.obstacle.trajectory is not None:
            raise ValueError("`obstacle.trajectory` has no meaning in a stream: send observations")


def require_own_names(field: str, declared: list[StreamObstacle]) -> None:
    """Raise ValueError, which names the place, if two of the shapes that are declared at once have the same name."""
    first: dict[str, int] = {}
    for index, one in enumerate(declared):
        name = one.obstacle.name
        if first.setdefault(name, index) != index:
            raise ValueError(
                f"`{field}[{index}].obstacle.name`: {name!r} is the name of `{field}[{first[name]}]` already:"
                " give it another"
            )


class Deviation(Message):
    """The largest deviation of an obstacle's velocity from the observed one, in place of its largest speed.

    Attributes:
        speed: Of the origin of its frame [m/s].
        angular_speed: Of its turning [rad/s].
    """

    speed: NonNegative
    angular_speed: NonNegative = 0.0

    def __post_init__(self) -> None:
        require_finite_number("speed", self.speed)
        require_finite_number("angular_speed", self.angular_speed)


class StreamOpen(Message):
    """Open a stream: pieces of motion towards a goal, each of which ends in a proven stop.

    Attributes:
        robot: A name of the catalog or of a stored robot, or the robot itself.
        scene: What rests; none of its obstacles may have a `trajectory`.
        goal: What to reach; null: to stand.
        schema: Version of this message.
        robot_placement: Of the robot's root in the world.
        group: Joints that move: a group's name or their names; null: every actuated joint between root and tip.
        tip: Frame that goals are about; null: the robot's own.
        start: Where the robot stands, at rest; joints left out are as the robot has it.
        attached_objects: Objects held by links.
        allowed_collisions: Pairs of links and obstacles that may touch; what is to be seen later is declared in
            `obstacles` for that.
        limits: Limits of joints, by name. Without a jerk limit the acceleration reaches its limit in 0.05 s.
        max_velocity_scaling_factor: Fraction of the velocity limits that is used.
        max_acceleration_scaling_factor: Fraction of the acceleration limits that is used.
        obstacles: What may be observed.
        assume: What is assumed of obstacles: that they keep their largest speeds, or that their velocities stay as
            observed but for a deviation.
        period: Time between two updates, as a rule [s].
        latency: From an update's `time` to the beginning of the piece that answers it [s].
        piece: How long a piece lasts before its braking begins [s]; more than `period`.
        age_limit: Where an observation is older, there is no piece [s].
        min_clearance: What moving links keep from every obstacle beyond all that [m].
        tracking_tolerance: How far any joint may be from where a piece has it [rad or m].
        clock_error: How far the `time` of an observation may be from the true one, on the client's clock [s].
        appear_distance: What isn't observed yet is at least so far from the robot whenever an update is made [m];
            null: nothing appears but what was observed.
        appear_speed: And moves at most so fast [m/s].
        planning_time: How long the planning of a way lasts [s]: it is taken over so long after it was asked for.
        seed: Of all randomness.
        recording: Whether a service keeps what is asked and answered, so that it can be done again.
        stream_id: What a service is to call the stream, new; null: the service makes a name.

    Example:
        >>> from guidefield import Box, JointsGoal, StreamObstacle, StreamOpen
        >>> crate = StreamObstacle(Box(name="crate", size=(0.1, 0.1, 0.1)), largest_speed=0.3)
        >>> opened = StreamOpen("ur5", "table", JointsGoal({"elbow_joint": 1.2}), obstacles=[crate])
        >>> opened.assume, opened.latency
        ('largest_speed', 0.02)
    """

    robot: RobotReference
    scene: SceneReference
    goal: StreamGoal | None = None
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    group: str | list[Name] | None = None
    tip: Name | None = None
    start: Positions = {}
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    limits: dict[str, JointLimits] = {}
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    obstacles: Annotated[list[StreamObstacle], msgspec.Meta(max_length=MOST_OBSTACLES)] = []
    assume: Literal["largest_speed"] | Deviation = "largest_speed"
    period: Seconds = 0.02
    latency: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.02
    piece: Seconds = 0.03
    age_limit: Positive = 0.5
    min_clearance: NonNegative = 0.0
    tracking_tolerance: NonNegative = 0.001
    clock_error: NonNegative = 0.0
    appear_distance: Positive | None = None
    appear_speed: NonNegative = 0.0
    planning_time: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.06
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0
    recording: Literal["full", "off"] = "full"
    stream_id: RunId | None = None

    def __post_init__(self) -> None:
        settle_scene(self)
        require_own_names("obstacles", self.obstacles)
        require_finite_positions("start", self.start)
        for field in ("age_limit", "min_clearance", "tracking_tolerance", "clock_error", "appear_speed"):
            require_finite_number(field, getattr(self, field))
        if self.appear_distance is not None:
            require_finite_number("appear_distance", self.appear_distance)
        if self.piece <= self.period:
            raise ValueError(f"`piece` must be more than `period` ({self.period} s), got {self.piece} s")


class Observation(Message):
    """An observation of an obstacle.

    Attributes:
        name: The obstacle.
        time: When, by the client's clock [s]; not after the update that brings it.
        placement: Of its frame in the world.
        velocity: Of the frame's origin [m/s, world]; counts where deviations are assumed, and for choosing motions.
        angular_velocity: [rad/s, world]; counts where deviations are assumed.
    """

    name: Name
    time: float
    placement: Placement = Placement()
    velocity: Vector3 = ORIGIN
    angular_velocity: Vector3 = ORIGIN

    def __post_init__(self) -> None:
        require_finite_number("time", self.time)
        require_finite("velocity", self.velocity)
        require_finite("angular_velocity", self.angular_velocity)


class StreamUpdate(Message):
    """The observations of a client.

    Attributes:
        time: By the client's clock [s]; later than that of every update before, else it is left aside.
        obstacles: What was observed since; what isn't in it is as it was observed last. An observation that is older
            than one before is left aside.
        joints: Where the robot is at `time`; null: where its piece has it.
        executing: Number of the piece that the robot executes at `time`; null: the last one that has begun.
        declare: Shapes that are new, or in place of those of the same name.
        gone: Obstacles that aren't there any more.
        schema: Version of this message.
    """

    time: float
    obstacles: Annotated[list[Observation], msgspec.Meta(max_length=MOST_OBSTACLES)] = []
    joints: Positions | None = None
    executing: int | None = None
    declare: Annotated[list[StreamObstacle], msgspec.Meta(max_length=MOST_OBSTACLES)] = []
    gone: Annotated[list[Name], msgspec.Meta(max_length=MOST_OBSTACLES)] = []
    schema: Literal[1] = 1

    def __post_init__(self) -> None:
        require_finite_number("time", self.time)
        require_own_names("declare", self.declare)
        if self.joints is not None:
            require_finite_positions("joints", self.joints)


class PieceTrajectory(Reply):
    """A motion of constant jerk between knots: exactly the cubic through their positions and velocities.

    Attributes:
        times: Of the knots, by the client's clock [s].
        positions: In the order of `position_names` [rad or m].
        velocities: [rad/s or m/s].
        accelerations: [rad/s^2 or m/s^2].
    """

    times: list[float]
    positions: list[list[float]]
    velocities: list[list[float]]
    accelerations: list[list[float]]


class Piece(Reply):
    """A piece of motion and the hardest braking after it, proven together.

    A client takes it if it executes the piece that this one `follows`, before it `begins`; until then it goes on with
    that one. What isn't followed by another piece is executed to its end, where the robot stands.

    Attributes:
        number: Counted from 1.
        update: Time of the update that it answers [s].
        follows: Number of the piece that it follows; 0: the robot stands at the start.
        goal: Number of the goal that it is about.
        begins: When it begins, by the client's clock [s].
        brakes: When its braking begins [s].
        stops: When the robot stands [s].
        leads_to: Where to: the goal's direction, or away from what comes close.
        reaches_goal: Whether the robot stands at the goal in the end.
        position_names: Names of the columns.
        trajectory: The motion from `begins` to `stops`.
        evaluations: Configurations at which it was certified.
    """

    number: int
    update: float
    follows: int
    goal: int
    begins: float
    brakes: float
    stops: float
    leads_to: Literal["goal", "away"]
    reaches_goal: bool
    position_names: list[str]
    trajectory: PieceTrajectory
    evaluations: int
    schema: int = 1


Reason = Literal[
    "at_goal",
    "standing",
    "too_close",
    "no_way",
    "goal_taken",
    "late",
    "stale",
    "tracking",
    "stopped",
    "appeared",
    "refused",
    "ended",
]


class StreamState(Reply):
    """Why an update got no piece; what was sent before is executed to its end.

    Attributes:
        update: Time of the update [s]; null where it couldn't be read, or there was none.
        reason: `at_goal`: the last piece ends there. `standing`: there is no goal. `too_close`: nothing could be
            proven. `no_way`: none was found to the goal. `goal_taken`: an obstacle is on it. `late`: an update before
            was later. `stale`: observations are too old. `tracking`: the robot isn't where its piece has it.
            `stopped`: a stop was asked for. `appeared`: the piece that is executed isn't proven against what was
            observed for the first time. Of a service alone: `refused`: the update is ill-posed. `ended`: the stream is
            over; no update is answered any more.
        pair: What couldn't be told apart: a link, and a link or an obstacle; null where that isn't the reason.
        time: Where that is, by the client's clock [s]; null as there.
        executing: Number of the piece that is executed.
        stops: When the robot stands [s].
        error: Why it is `refused` or `ended`; null otherwise.
    """

    update: float | None
    reason: Reason
    pair: tuple[str, str] | None
    time: float | None
    executing: int
    stops: float
    error: ErrorReply | None = None
    schema: int = 1
