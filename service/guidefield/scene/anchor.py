"""Express requests, replies and scenes relative to an anchor: a point near a robot that is far from the world's origin.

An anchor has whole metres: positions near it are counted from it without rounding, and single precision holds it in
recordings. A new field of a request or reply that is a point of the world has the type `WorldPoint`, never optional;
other places, messages with some, and configurations have to be added to `_WORLD`, rows of joint values to
`_shift_columns`: what isn't listed there stays as it is, and is wrong for robots far away.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import msgspec
import numpy as np

from guidefield.geometry.surfaces import se3
from guidefield.memo import memoized
from guidefield.messages import replies, requests, scene as messages
from guidefield.messages.conditions import PackedNumbers
from guidefield.messages.execution import ExecutionOptions
from guidefield.messages.kinematics import PackedClearance
from guidefield.messages.scene import Points
from guidefield.messages.streams import StreamOpen
from guidefield.messages.values import ORIGIN, Float32Array, Placement, Vector3, WorldPoint
from guidefield.scene.obstacle_message import points_in
from guidefield.scene.scene import Scene, build

FAR = 100.0
"""A robot farther from the origin along an axis, or its mobile base from zero, gets an anchor [m]. It must not grow:
single precision resolves 8 um there, `BAND` is hardly more. service/docs/certificate.md has it, and `NEAR_ORIGIN`."""

COARSE = 16384.0  # from here on a warning mentions single precision, which has steps of more than a millimetre [m]

_Message = TypeVar("_Message", bound=msgspec.Struct)


class Anchor(msgspec.Struct, frozen=True):
    """An anchor, and how far a mobile base's joint values are shifted with it."""

    place: Vector3  # in the world, whole metres [m]
    joint: str = ""  # a planar or floating first joint that starts far from its zero, whose values are shifted; or none
    values: tuple[float, ...] = ()  # by how much, in the joint's own directions, whole metres [m]
    root: Vector3 = ORIGIN  # the same shift in the world's directions, shape (3,) [m]

    @classmethod
    def of(cls, request: Any, load: Callable[[Any], Any]) -> Anchor | None:
        """Find the anchor of a request; None if its robot is near the origin, or it has none.

        Args:
            request: Of any kind.
            load: Loads a robot.
        """
        if type(request) not in _WORLD or getattr(request, "robot", None) is None:
            return None
        at = request.robot_placement
        if isinstance(request, requests.PlanRequest | requests.CertifyRequest) and _is_any_far(request):
            robot = load(request.robot)
            joint = robot.joints[0]
            count = {"planar": 2, "floating": 3}.get(joint.kind, 0)
            value = _place_of(request, joint.name, count) if robot.model.parents[joint.index] == 0 and count else None
            if value is not None:
                values = np.round(value)
                own = np.array(robot.model.jointPlacements[joint.index].rotation)[:, :count] @ values
                root = se3(at.position, at.quaternion_xyzw).rotation @ own
                place = np.round(np.array(at.position) + root)
                return cls((*place.tolist(),), joint.name, (*values.tolist(),), (*root.tolist(),))
        x, y, z = (float(round(x)) for x in at.position)
        return cls((x, y, z)) if max(map(abs, at.position)) > FAR else None

    def inward(self, message: _Message) -> _Message:
        """Return a message of the world relative to the anchor; a scene in a request stays: see `see`."""
        return cast(_Message, _shift_message(message, self, -1.0))

    def outward(self, message: _Message) -> _Message:
        """Return a message relative to the anchor in the world again."""
        return cast(_Message, _shift_message(message, self, 1.0))

    def see(self, scene: Scene) -> Scene:
        """Return a scene of the world relative to the anchor."""
        return _shift_scene(scene, self)

    def show(self, obstacle: messages.Obstacle) -> messages.Obstacle:
        """Return an obstacle relative to the anchor in the world again."""
        return cast(messages.Obstacle, _shift_obstacle(obstacle, np.array(self.place)))

    def show_placement(self, placement: Placement) -> Placement:
        """Return a placement relative to the anchor in the world again."""
        return Placement(_vector(placement.position, self, 1.0), placement.quaternion_xyzw)

    def coarse_warnings(self, request: Any, scene: Scene | None) -> list[str]:
        """Return a warning if positions of a request or its scene came in single precision, too coarse for them."""
        if (far := max(map(abs, self.place))) < COARSE:
            return []
        declared = () if scene is None else scene.message.obstacles
        numbers = [x for one in declared for x in getattr(one, "position", ())]
        coarse = [f"the points of {one.name!r} are" for one in declared if _is_coarse(one)]
        if numbers and all(float(np.float32(x)) == x for x in (*request.robot_placement.position, *numbers)):
            coarse.append("all positions are")
        apart = 1e3 * float(np.spacing(np.float32(far)))
        return [
            f"{who} in single precision, which has steps of {apart:.0f} mm so far from the origin: give them in double"
            " precision"
            for who in coarse[:1]
        ]


def _is_any_far(request: requests.PlanRequest | requests.CertifyRequest) -> bool:
    """Return whether a joint value with which a motion begins is far from its zero."""
    values = [x for value in request.start.values() if isinstance(value, list) for x in value]
    first = _find_given_rows(request)[0][0] if isinstance(request, requests.CertifyRequest) else []
    return any(abs(x) > FAR for x in (*values, *first))


def _find_given_rows(request: requests.CertifyRequest) -> list[replies.Rows]:
    trajectories = [one.positions for one in (request.trajectory, request.planned) if one is not None]
    return [request.path, *trajectories] if request.path is not None else trajectories


def _place_of(request: requests.PlanRequest | requests.CertifyRequest, joint: str, count: int) -> list[float] | None:
    """Return where a planar or floating joint starts, in its directions (count,) [m]; None if that isn't given."""
    if isinstance(request, requests.CertifyRequest):
        (first, *_), *_ = _find_given_rows(request)
        if (names := _name_columns(request, joint, count)) is not None and joint + ".x" in names:
            at = names.index(joint + ".x")
            return first[at : at + count] if len(first) >= at + count else None
    value = request.start.get(joint)
    return value[:count] if isinstance(value, list) and len(value) > count else None


def _name_columns(request: requests.CertifyRequest, joint: str, count: int) -> list[str] | None:
    """Return the known names of the columns of a given motion; those of a robot's first joint stand first."""
    if request.position_names is not None:
        return request.position_names
    moves = request.group is None or (isinstance(request.group, list) and request.group[0] == joint)
    return _columns_of(joint, count) if moves else None


def _columns_of(joint: str, count: int) -> list[str]:
    return [joint + suffix for suffix in (".x", ".y", ".z")[:count]]


@memoized
def _shift_scene(scene: Scene, anchor: Anchor) -> Scene:
    obstacles = [_shift_obstacle(one, -np.array(anchor.place)) for one in scene.message.obstacles]
    planes = [anchor.inward(plane) for plane in scene.message.guide_planes]
    return build(msgspec.structs.replace(scene.message, obstacles=obstacles, guide_planes=planes))


def _is_coarse(one: messages.Obstacle) -> bool:
    points = getattr(one, "points", getattr(one, "vertices", None))
    return isinstance(points, Float32Array) and float(np.abs(points_in(points)).max()) >= COARSE


def _shift_obstacle(one: Any, by: np.ndarray) -> Any:
    """Shift an obstacle; one whose own points are far from its frame gets a frame among them."""
    field = next((field for field in ("points", "vertices") if hasattr(one, field)), None)
    resting = one.trajectory is None
    if field is not None and resting and not isinstance(one, messages.Mesh):
        return msgspec.structs.replace(one, **{field: _points(getattr(one, field), by)})
    if isinstance(one, messages.HalfSpace) and resting:
        return msgspec.structs.replace(one, offset=one.offset + float(np.array(one.normal) @ by))
    changed: dict[str, Any] = {}
    centre = np.zeros(3) if field is None else np.round(points_in(getattr(one, field)).mean(axis=0))
    if np.abs(centre).max() > FAR:
        assert field is not None, "it has points"
        changed[field] = _points(getattr(one, field), -centre)
    else:
        centre = np.zeros(3)
    if resting:
        turned = getattr(one, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
        return msgspec.structs.replace(one, position=_place(one.position, turned, centre, by), **changed)
    placements = [_shift_placement(each, centre, by) for each in one.trajectory.placements]
    return msgspec.structs.replace(
        one, trajectory=messages.ObstacleTrajectory(one.trajectory.times, placements), **changed
    )


def _shift_placement(one: Placement, centre: np.ndarray, by: np.ndarray) -> Placement:
    return Placement(_place(one.position, one.quaternion_xyzw, centre, by), one.quaternion_xyzw)


def _place(position: Vector3, turned: Sequence[float], centre: np.ndarray, by: np.ndarray) -> Vector3:
    x, y, z = (np.array(position) + by + (se3((0, 0, 0), turned).rotation @ centre if centre.any() else 0.0)).tolist()
    return x, y, z


def _points(points: Points, by: np.ndarray) -> Points:
    shifted = points_in(points) + by
    if isinstance(points, Float32Array):
        return Float32Array(shifted.astype("<f4").tobytes())
    return [*map(tuple, shifted.tolist())]


def _shift_message(message: Any, anchor: Anchor, sign: float) -> Any:
    """Shift all places of a message in the world by the anchor's place, or back where the sign is -1."""
    kind: Any = type(message)
    fields = world_fields(kind)
    found = {field: value for field in fields if (value := getattr(message, field)) is not None}
    changed = {field: fields[field](value, anchor, sign) for field, value in found.items()}
    if anchor.joint and isinstance(message, _OF_COLUMNS):
        changed |= _shift_columns(message, anchor, sign)
    return msgspec.structs.replace(message, **changed) if changed else message


_OF_COLUMNS = requests.CertifyRequest | replies.PlanReply | replies.CertifyReply
"""Messages with rows of joint values."""


def _shift_columns(
    message: requests.CertifyRequest | replies.PlanReply | replies.CertifyReply, anchor: Anchor, sign: float
) -> dict[str, Any]:
    """Return the fields of a message that hold values of the anchor's joint, shifted."""
    columns = _columns_of(anchor.joint, len(anchor.values))
    by = dict(zip(columns, (sign * value for value in anchor.values), strict=True))
    names: Sequence[str] = (
        (_name_columns(message, anchor.joint, len(columns)) or [])
        if isinstance(message, requests.CertifyRequest)
        else message.position_names
    )
    changed: dict[str, Any] = {}
    if columns[0] in names:
        for field in ("path", "trajectory", "planned", "execution"):
            if (value := getattr(message, field, None)) is None or isinstance(value, ExecutionOptions):
                continue
            if isinstance(value, list):
                changed[field] = _rows(value, names, by)
            else:
                changed[field] = msgspec.structs.replace(value, positions=_rows(value.positions, names, by))
    if isinstance(message, requests.CertifyRequest):
        return changed

    def outward(at: dict[str, float]) -> dict[str, float]:
        return {name: value + by.get(name, 0.0) for name, value in at.items()}

    if at := message.status.details.get("configuration"):
        details = {**message.status.details, "configuration": outward(at)}
        changed["status"] = msgspec.structs.replace(message.status, details=details)
    if isinstance(message, replies.CertifyReply) and (place := message.certificate.place) is not None:
        place = msgspec.structs.replace(place, configuration=outward(place.configuration))
        changed["certificate"] = msgspec.structs.replace(message.certificate, place=place)
    return changed


def _rows(rows: replies.Rows, names: Sequence[str], by: dict[str, float]) -> replies.Rows:
    width = len(rows[0]) if rows else 0
    added = [by.get(name, 0.0) for name in names] + [0.0] * (width - len(names))
    if any(len(row) != len(added) for row in rows):
        return rows  # which is refused
    return [[value + more for value, more in zip(row, added, strict=True)] for row in rows]


def _inner(value: Any, anchor: Anchor, sign: float) -> Any:
    if isinstance(value, list):
        return [_shift_message(one, anchor, sign) for one in value]
    return _shift_message(value, anchor, sign)


def _vector(value: Vector3, anchor: Anchor, sign: float) -> Vector3:
    (x, y, z), (a, b, c) = value, anchor.place
    return x + sign * a, y + sign * b, z + sign * c


def _vectors(value: Sequence[Any], anchor: Anchor, sign: float) -> list[Any]:
    return [
        one if one is None else (_vectors if isinstance(one[0], list | tuple) else _vector)(one, anchor, sign)
        for one in value
    ]


def _root(value: Placement, anchor: Anchor, sign: float) -> Placement:
    position = _vector(value.position, anchor, sign)
    return Placement(_vector(position, Anchor(anchor.root), -sign), value.quaternion_xyzw)


def _configurations(value: Any, anchor: Anchor, sign: float) -> Any:
    if isinstance(value, list):
        return [_configurations(one, anchor, sign) for one in value]
    at = value.get(anchor.joint)
    if not isinstance(at, list):
        return value
    count = min(len(at), len(anchor.values))
    shifted = [x + sign * by for x, by in zip(at[:count], anchor.values, strict=False)]
    return {**value, anchor.joint: [*shifted, *at[count:]]}


def _shift_numbers(value: PackedNumbers, anchor: Anchor, sign: float) -> PackedNumbers:
    numbers = np.frombuffer(value.float64, "<f8").reshape(value.shape) + sign * np.array(anchor.place)
    return PackedNumbers(shape=value.shape, float64=numbers.tobytes())


_PLACED: dict[str, Callable[[Any, Anchor, float], Any]] = {"robot_placement": _root}

_WORLD: dict[type, dict[str, Callable[[Any, Anchor, float], Any]]] = {
    requests.PlanRequest: {
        **_PLACED,
        "start": _configurations,
        **dict.fromkeys(("goal", "guide_planes", "path_constraints", "steps"), _inner),
    },
    requests.PlanStep: dict.fromkeys(("goal", "guide_planes"), _inner),
    requests.CertifyRequest: {**_PLACED, "start": _configurations, "path_constraints": _inner},
    requests.InverseKinematics: {**_PLACED, "poses": _inner},
    requests.Clearance: _PLACED,
    requests.Potential: _PLACED,
    StreamOpen: {**_PLACED, "goal": _inner},
    requests.JointsGoal: {"positions": _configurations},
    requests.JointSetGoal: {"positions": _configurations},
    messages.GuidePlane: {"vertices": _vectors},
    replies.PlanReply: {"guide_planes": _inner},
    replies.ClearanceReply: {"witness_points": _vectors, "packed": _inner},
    PackedClearance: {"witness_points": _shift_numbers},
}
"""The fields in the world's coordinates of requests and replies about a robot, but `WorldPoint`s, and their shifts."""


@functools.cache
def world_fields(kind: Any) -> dict[str, Callable[[Any, Anchor, float], Any]]:
    """Return the fields of a kind of message in the world's coordinates, and how each is shifted."""
    hints = typing.get_type_hints(kind, include_extras=True)
    points = [field for field in kind.__struct_fields__ if hints[field] == WorldPoint]
    return {**dict.fromkeys(points, _vector), **_WORLD.get(kind, {})}
