"""Messages of streams: the request that opens one, observations of a client, and pieces of motion.

All times are on the client's clock, in seconds from an origin of its choice; they are compared with no other clock.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import (
    AllowedCollisions,
    AttachedObjects,
    CartesianLimits,
    JointLimits,
    RobotReference,
    SceneReference,
    settle_scene,
)
from guidefield.messages.replies import ErrorReply
from guidefield.messages.scene import Obstacle
from guidefield.messages.values import (
    ORIGIN,
    JointSetGoal,
    JointsGoal,
    Message,
    Name,
    NonNegative,
    Placement,
    PoseGoal,
    Positions,
    Positive,
    Reply,
    RunId,
    Vector3,
    require_finite,
    require_finite_number,
    require_finite_positions,
)

DEFAULT_STREAMS = 4  # default of the largest number of open streams of a service; docs/service.md tells it, too
MOST_STREAM_OBSTACLES = 10_000
"""The largest number of obstacles of a stream."""

MOST_UPDATE_BYTES = 16 << 20
"""The largest update that a service decodes [bytes]."""

Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]

StreamGoal = JointsGoal | JointSetGoal | PoseGoal


class StreamObstacle(Message):
    """A shape that may be observed, with bounds on its motion.

    Attributes:
        obstacle: Its shape. Observations place a box, cylinder, capsule, sphere or mesh; of a polygon, a half-space and
            a point cloud they place the frame of its coordinates.
        largest_speed: Of the origin of its frame [m/s].
        largest_angular_speed: Of its rotation about that origin [rad/s].
        uncertainty: Largest distance of any of its points from the observed place [m].
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
    """Raise ValueError, with the place, if two shapes of a list have the same name."""
    first: dict[str, int] = {}
    for index, one in enumerate(declared):
        name = one.obstacle.name
        if first.setdefault(name, index) != index:
            raise ValueError(
                f"`{field}[{index}].obstacle.name`: {name!r} is the name of `{field}[{first[name]}]` already:"
                " give it another"
            )


class Deviation(Message):
    """The largest deviation of an obstacle's velocity from the observed one, instead of its largest speed.

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
        scene: The obstacles at rest; none may have a `trajectory`.
        goal: The goal; null: to stand.
        robot_placement: Of the robot's root in the world.
        group: Joints that move: a group's name or their names; null: every actuated joint between root and tip.
        tip: Frame that reaches goals; null: the robot's own.
        start: Configuration in which the robot stands; joints left out are at the robot's rest configuration.
        attached_objects: Objects held by links.
        allowed_collisions: Pairs of links and obstacles that may touch; the obstacles must be declared.
        limits: Limits of joints, by name. Without a jerk limit the acceleration reaches its limit in 0.05 s.
        cartesian_limits: Limits of the speed of frames and links in space; `acceleration` is not served.
        max_velocity_scaling_factor: Fraction of the velocity limits that is used.
        max_acceleration_scaling_factor: Fraction of the acceleration limits that is used.
        obstacles: Shapes that may be observed.
        assume: Assumption on obstacles: they keep their largest speeds, or their observed velocities up to a deviation.
        period: Usual time between two updates [s].
        latency: From an update's `time` to the beginning of the piece that answers it [s].
        piece: Duration of a piece before its braking begins [s]; more than `period`.
        age_limit: Largest age of an observation [s]; with an older one there is no piece.
        min_clearance: Additional distance that moving links keep from every obstacle [m].
        tracking_tolerance: Largest deviation of any joint from its piece [rad or m].
        clock_error: Largest error of the `time` of an observation, on the client's clock [s].
        appear_distance: Smallest distance to the robot of an obstacle that isn't observed yet, at any update [m]; null:
            no unobserved obstacle appears.
        appear_speed: Largest speed of such an obstacle [m/s].
        planning_time: Time from the request of a path to its takeover [s].
        seed: Of all randomness.
        recording: Whether a service stores updates and answers, so that the stream can be replayed.
        stream_id: A new name of the stream; null: the service makes one.

    Examples:
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
    cartesian_limits: CartesianLimits = []
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    obstacles: Annotated[list[StreamObstacle], msgspec.Meta(max_length=MOST_STREAM_OBSTACLES)] = []
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
        time: Time of the observation, by the client's clock [s]; not after its update.
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
        time: By the client's clock [s]; later than that of every earlier update, else the update is ignored.
        obstacles: New observations; other obstacles keep their last one. An observation that is older than an earlier
            one is ignored.
        joints: Configuration of the robot at `time`; null: that of its piece.
        executing: Number of the piece that the robot executes at `time`; null: the last one that has begun.
        declare: New shapes; they replace those of the same name.
        gone: Obstacles that have disappeared.
    """

    time: float
    obstacles: Annotated[list[Observation], msgspec.Meta(max_length=MOST_STREAM_OBSTACLES)] = []
    joints: Positions | None = None
    executing: int | None = None
    declare: Annotated[list[StreamObstacle], msgspec.Meta(max_length=MOST_STREAM_OBSTACLES)] = []
    gone: Annotated[list[Name], msgspec.Meta(max_length=MOST_STREAM_OBSTACLES)] = []
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

    A client takes it if it still executes the piece that this one `follows` when this one `begins`; until then it
    executes that one. A piece without a following one is executed to its end, where the robot stands.

    Attributes:
        number: Counted from 1.
        update: Time of the update that it answers [s].
        follows: Number of the piece that it follows; 0: the robot stands at the start.
        goal: Number of its goal.
        begins: Its begin, by the client's clock [s].
        brakes: Begin of its braking [s].
        stops: Time at which the robot stands [s].
        leads_to: Its direction: towards the goal, or away from an approaching obstacle.
        reaches_goal: Whether the robot stands at the goal in the end.
        position_names: Names of the columns.
        trajectory: The motion from `begins` to `stops`.
        evaluations: Segments of time in which it was certified.
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
    """The reason why an update got no piece; the piece before is executed to its end.

    Attributes:
        update: Time of the update [s]; null if it couldn't be decoded, or there was none.
        reason: `at_goal`: the robot stands there, or will. `standing`: there is no goal. `too_close`: nothing could be
            proven. `no_way`: none was found to the goal. `goal_taken`: an obstacle is on it. `late`: an update before
            was later. `stale`: observations are too old. `tracking`: the robot isn't where its piece has it.
            `stopped`: a stop was asked for. `appeared`: the piece that is executed isn't proven against what was
            observed for the first time. Of a service alone: `refused`: the update is ill-posed. `ended`: the stream is
            over; no update is answered any more.
        pair: The bodies that couldn't be proven apart: a link, and a link or an obstacle; null for other reasons.
        time: Time of that, by the client's clock [s]; null as there.
        executing: Number of the piece that is executed.
        stops: Time at which the robot stands [s].
        error: The error of `refused` or `ended`; else null.
    """

    update: float | None
    reason: Reason
    pair: tuple[str, str] | None
    time: float | None
    executing: int
    stops: float
    error: ErrorReply | None = None
    schema: int = 1
