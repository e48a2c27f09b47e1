"""Configurations and rows of motions in requests, as arrays: columns by name, in any order.

Columns are those of a plan's reply. A continuous joint goes the shorter way from one row to the next, as other planners
mean it: their angles may have been brought within one turn. So does a planar joint's angle, and a ball joint may have
its quaternions with either sign. A mimic joint may have a column if its values are those of its law.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import cast

import numpy as np

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.errors import InvalidConfiguration, MalformedRequest, at_path
from guidefield.geometry.surfaces import se3
from guidefield.messages.conditions import ConfigurationBatch, ConfigurationTable, JointRates, PackedNumbers
from guidefield.messages.requests import Positions
from guidefield.messages.values import QUATERNION_TOLERANCE, Placement
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import (
    ANGLE,
    LARGEST_VALUE,
    POSITION_SUFFIXES,
    ROTATION,
    VELOCITY_SUFFIXES,
    Joint,
    JointKind,
    LocalPoints,
    LocalRates,
    ModelConfigurations,
    RobotConfigurations,
    to_local,
    unwrap_near,
)
from guidefield.robot.model.model import RobotModel

# how far a mimic joint's column may be from its law [rad or m, and per s] (docs/certify.md): the law is certified, not
# the column, so a given motion may be off by this, uncertified
MIMIC_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Columns:
    """The columns of each joint in a row."""

    field: str  # the request's field with the names, for messages
    names: tuple[str, ...]  # of all columns, in the order of a row
    of: Mapping[str, tuple[int, ...]]  # by joint, the indices of its columns in the order of its coordinates

    @classmethod
    def named(
        cls, field: str, names: Sequence[str], robot: RobotModel, suffixes: Mapping[JointKind, Sequence[str]]
    ) -> Columns:
        """Find the columns of each joint; `suffixes` are those of kinds of joints with several columns, in order.

        Raises InvalidConfiguration if a name is none of the robot's, stands twice, or a joint lacks one of its columns.
        """
        known = {
            joint.name: tuple(joint.name + end for end in suffixes.get(joint.kind, ("",))) for joint in robot.joints
        }
        available = [name for columns in known.values() for name in columns]
        for name, count in Counter(names).items():
            if name not in available:
                raise InvalidConfiguration(
                    f"`{field}` has {name!r}, which robot {robot.name!r} hasn't; it has {', '.join(available)}",
                    column=name,
                    available=available,
                )
            if count > 1:
                raise InvalidConfiguration(f"`{field}` has {name!r} {count} times", column=name)
        for joint, columns in known.items():
            lacking = [name for name in columns if name not in names]
            if lacking and len(lacking) < len(columns):
                raise InvalidConfiguration(f"`{field}` lacks {lacking[0]!r} of joint {joint!r}", column=lacking[0])
        places = {name: index for index, name in enumerate(names)}
        of = {
            joint: tuple(places[name] for name in columns) for joint, columns in known.items() if columns[0] in places
        }
        return cls(field, tuple(names), of)

    def require_width(self, field: str, rows: np.ndarray) -> None:
        """Raise InvalidConfiguration unless rows (n, k) have as many values as there are columns."""
        if rows.shape[1] != len(self.names):
            raise InvalidConfiguration(
                f"`{field}` has {rows.shape[1]} values in a row, but there are {len(self.names)} columns:"
                f" {', '.join(self.names)}; `{self.field}` may say others",
                available=list(self.names),
            )


def rows_in(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """Return rows of one length, which messages have checked, as an array of shape (n, k)."""
    flat = chain.from_iterable(rows)  # which NumPy reads in a third of the time
    width = len(rows[0])
    return np.fromiter(flat, float, width * len(rows)).reshape(len(rows), width)


def first_positions(columns: Columns, rows: np.ndarray, robot: RobotModel) -> Positions:
    """The first of some rows (n, k) as joint names and values, without mimic joints."""
    first = rows[0].tolist()
    values = {name: [first[index] for index in at] for name, at in columns.of.items()}
    free = {joint.name for joint in robot.joints if joint.mimic is None}
    return {name: value[0] if len(value) == 1 else value for name, value in values.items() if name in free}


def local_points(columns: Columns, rows: np.ndarray, group: PlanningGroup, field: str) -> tuple[LocalPoints, list[str]]:
    """The local coordinates of rows.

    Args:
        columns: The columns of each joint.
        rows: Shape (n, k) [rad, m, or entries of a quaternion].
        group: The moving joints; one without a column stays where it is in `q_origin`, the group's start.
        field: The request's field with the rows, for messages.

    Returns:
        Shape (n, nv), each next to the one before; and warnings about whole turns that were added.

    Raises:
        InvalidConfiguration: if a value is too large, a quaternion is none, or a mimic joint is not where its law says.
    """
    if len(far := np.argwhere(np.abs(rows) > LARGEST_VALUE)):
        row, column = far[0].tolist()
        raise InvalidConfiguration(
            f"`{field}[{row}]`: {columns.names[column]} may be {LARGEST_VALUE:g} at most, got {rows[row, column]:g}",
            column=columns.names[column],
            row=row,
        )
    points, warnings = np.tile(group.to_local(group.q_origin), (len(rows), 1)), []
    for joint in group.joints:
        if (at := columns.of.get(joint.name)) is None:
            continue
        given = rows[:, list(at)]
        mine = slice(joint.idx_v, joint.idx_v + joint.nv)
        if joint.kind in ROTATION:
            require_quaternions(joint, given, field)
            points[:, mine] = _unwrap_rotations(joint, given, group.q_origin[joint.idx_q : joint.idx_q + joint.nq])
            continue
        if joint.kind in ANGLE:
            angle = ANGLE[joint.kind]
            given[:, angle], jump = _unwrap_angles(given[:, angle])
            if jump is not None:
                warnings.append(
                    f"joint {joint.name} goes the shorter way from row {jump} to row {jump + 1}: its angles are taken"
                    " by whole turns"
                )
        points[:, mine] = given
    moves = cast(LocalPoints, points)
    _require_mimic_columns(columns, rows, group, moves, field)
    return moves, warnings


def local_rates(
    columns: Columns, rows: np.ndarray, group: PlanningGroup, points: LocalPoints, field: str
) -> LocalRates:
    """Rates of local coordinates (n, nv) from rows (n, k) of velocities in the tangent space: shape (n, nv).

    Raises InvalidConfiguration if a mimic joint's velocity is not that of its law.
    """
    tangents = np.zeros(points.shape)
    for joint in group.joints:
        if (at := columns.of.get(joint.name)) is not None:
            tangents[:, joint.idx_v : joint.idx_v + joint.nv] = rows[:, list(at)]
    _require_mimic_columns(columns, rows, group, tangents, field, rates=True)
    if group.is_euclidean:
        return cast(LocalRates, tangents)
    rates = [np.linalg.solve(group.tangent_map(z), v) for z, v in zip(points, tangents, strict=True)]
    return cast(LocalRates, np.array(rates))


def _unwrap_angles(angles: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Add whole turns to angles (n,), each to be next to the one before; return also the row before the first turn."""
    turns = -np.round(np.diff(angles) / (2.0 * np.pi))
    jumps = np.flatnonzero(turns)
    if not len(jumps):
        return angles, None
    return angles + 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(turns)]), int(jumps[0])


def require_quaternions(joint: Joint, given: np.ndarray, field: str) -> None:
    """Raise InvalidConfiguration unless the quaternions in a joint's columns (n, nq) have norm 1."""
    norms = np.linalg.norm(given[:, -4:], axis=1)
    if len(off := np.flatnonzero(np.abs(norms - 1.0) > QUATERNION_TOLERANCE)):
        row = int(off[0])
        raise InvalidConfiguration(
            f"`{field}[{row}]`: the quaternion of joint {joint.name!r} must have norm 1, it has {norms[row]:.9g}",
            joint=joint.name,
            row=row,
        )


def _unwrap_rotations(joint: Joint, given: np.ndarray, reference: np.ndarray) -> np.ndarray:
    found = [to_local(joint, given[0], reference)]
    for values in given[1:]:
        found.append(unwrap_near(joint, to_local(joint, values, reference), found[-1]))
    return np.array(found)


def _mimic_columns(columns: Columns, group: PlanningGroup) -> list[tuple[Joint, int, Joint | None]]:
    """Mimic joints that have a column: the joint, its column, and its source joint, None where that stands still."""
    planned = {joint.name: joint for joint in group.joints}
    return [
        (joint, columns.of[joint.name][0], planned.get(joint.mimic.source))
        for joint in group.robot.joints
        if joint.mimic is not None and joint.name in columns.of
    ]


def _require_mimic_columns(
    columns: Columns, rows: np.ndarray, group: PlanningGroup, moves: np.ndarray, field: str, *, rates: bool = False
) -> None:
    """Refuse columns of mimic joints that don't keep their laws at local coordinates (n, nv), or at their `rates`."""
    for joint, column, source in _mimic_columns(columns, group):
        assert joint.mimic is not None, "it follows another"
        if source is not None:
            expected = joint.mimic.multiplier * moves[:, source.idx_v] + (0.0 if rates else joint.mimic.offset)
        else:
            stands = group.q_reference[joint.idx_q : joint.idx_q + joint.nq]
            expected = np.full(len(rows), 0.0 if rates else to_local(joint, stands, stands)[0])
        apart = rows[:, column] - expected
        if joint.kind is JointKind.CONTINUOUS and not rates:
            apart -= 2.0 * np.pi * np.round(apart / (2.0 * np.pi))
        if len(off := np.flatnonzero(np.abs(apart) > MIMIC_TOLERANCE)):
            row = int(off[0])
            raise InvalidConfiguration(
                f"`{field}[{row}]`: joint {joint.name!r} follows {joint.mimic.source!r}, by whose value it is"
                f" {expected[row]:.6g}; the row has it {abs(apart[row]):.3g} off: leave its column out",
                joint=joint.name,
                row=row,
            )


def velocity_names_of(columns: Columns, robot: RobotModel) -> list[str]:
    """Names of the velocity columns of the joints that have position columns, in the order of these."""
    first = sorted(columns.of, key=lambda name: min(columns.of[name]))
    joints = {joint.name: joint for joint in robot.joints}
    return [name + end for name in first for end in VELOCITY_SUFFIXES.get(joints[name].kind, ("",))]


def require_same_joints(positions: Columns, velocities: Columns) -> None:
    """Raise MalformedRequest unless the joints of some velocity columns are those of the position columns."""
    for one, other in ((positions, velocities), (velocities, positions)):
        if lacking := [name for name in one.of if name not in other.of]:
            raise MalformedRequest(
                f"`{other.field}` has no column of joint {lacking[0]!r}, which `{one.field}` has", joint=lacking[0]
            )


CONFIGURATIONS_PER_CHECK = 16
"""Configurations answered between two checks of the deadline: with the slowest robots a few milliseconds.

Replies are the same to the last bit with any number above 0.
"""


def configurations_from(robot: RobotModel, given: ConfigurationBatch) -> RobotConfigurations:
    """Return configurations of the whole robot, mimic joints included, shape (n, nq).

    Raises InvalidConfiguration if a joint is unknown or a mimic joint, or a value doesn't fit it.
    """
    if isinstance(given, ConfigurationTable):
        rows = rows_in(given.rows) if given.rows else _unpack_rows(given)
        columns = Columns.named("configurations.names", given.names, robot, POSITION_SUFFIXES)
        return _of_rows(robot, columns.of, rows, "configurations.rows")
    if (values := _scalar_rows(given)) is not None:
        with at_path("$.configurations[0]"):
            configuration_from_wire(robot, given[0])  # every fault of a name is found in the first
        if np.abs(values).max(initial=0.0) <= LARGEST_VALUE:
            return _of_rows(robot, {name: (index,) for index, name in enumerate(given[0])}, values, "configurations")
    found = np.empty((len(given), robot.model.nq))
    for index, positions in enumerate(given):
        with at_path(f"$.configurations[{index}]"):
            found[index] = configuration_from_wire(robot, positions)
    return cast(RobotConfigurations, found)


def frame_ids(robot: RobotModel, names: Sequence[str]) -> list[int]:
    """Return Pinocchio's indices of the `frames` of a request; raises UnknownFrame if the robot lacks one."""
    found = []
    for index, name in enumerate(names):
        with at_path(f"$.frames[{index}]"):
            found.append(robot.frame_id(name))
    return found


def model_configurations(group: PlanningGroup, configurations: RobotConfigurations) -> ModelConfigurations:
    """Return the robot's configurations as those of the model of `whole_group`, shape (n, model.nq)."""
    assert [*group.model.names] == [*group.robot.model.names], "all joints of the robot are in the group's model"
    return cast(ModelConfigurations, configurations)


def batches(deadline: Deadline, count: int, together: int = CONFIGURATIONS_PER_CHECK) -> Iterator[slice]:
    """Yield slices of `count` configurations, as long as there is time.

    Raises DeadlineExpired as `require_time`, before a slice.
    """
    for begin in range(0, count, together):
        require_time(deadline, begin, count)
        yield slice(begin, min(begin + together, count))


def require_time(deadline: Deadline, done: int, of: int) -> None:
    """Check the deadline after some configurations, poses or points of those requested.

    Raises DeadlineExpired if it passed.
    """
    if (status := deadline.status()) is not None:
        raise DeadlineExpired(status, f"{done} of {of}", done=done, of=of)


def whole_group(robot: RobotModel, placement: Placement) -> PlanningGroup:
    """Return all joints of a robot that are no mimic joints, as a planning group."""
    joints = [joint.name for joint in robot.joints if joint.mimic is None]
    return select(robot, joints, None, robot.rest, se3(placement.position, placement.quaternion_xyzw))


def pack_numbers(numbers: np.ndarray) -> PackedNumbers:
    """Return an array of any shape as a message."""
    return PackedNumbers(shape=list(numbers.shape), float64=numbers.astype("<f8").tobytes())


def rates_from(group: PlanningGroup, given: JointRates, field: str) -> np.ndarray:
    """Return velocities or accelerations of a group's joints, shape (n, nv); joints that are not given have none.

    Raises InvalidConfiguration if a joint is unknown or a mimic joint, or a value doesn't fit it.
    """
    robot = group.robot
    if isinstance(given, ConfigurationTable):
        columns = Columns.named(f"{field}.names", given.names, robot, VELOCITY_SUFFIXES)
        rows = rows_in(given.rows) if given.rows else _unpack_rows(given)
        rates = np.zeros((len(rows), group.nv))
        for name, at in columns.of.items():
            rates[:, _tangent(group, name)] = rows[:, list(at)]
        return rates
    rates = np.zeros((len(given), group.nv))
    for index, (row, values) in enumerate(zip(rates, given, strict=True)):
        for name, value in values.items():
            tangent = _tangent(group, name)
            numbers = value if isinstance(value, list) else [value]
            if len(numbers) != len(row[tangent]):
                raise InvalidConfiguration(
                    f"`{field}[{index}]`: joint {name!r} has {len(row[tangent])} numbers, not {len(numbers)}",
                    joint=name,
                )
            row[tangent] = numbers
    return rates


def _tangent(group: PlanningGroup, name: str) -> slice:
    joint = next((joint for joint in group.joints if joint.name == name), None)
    if joint is None:
        configuration_from_wire(group.robot, {name: 0.0})  # refuses a joint that isn't there, and a mimic joint
        raise AssertionError("all joints that are no mimic joints are in the group")
    return slice(joint.idx_v, joint.idx_v + joint.nv)


def _unpack_rows(table: ConfigurationTable) -> np.ndarray:
    return np.frombuffer(table.float64 or b"", "<f8").astype(float).reshape(-1, len(table.names))


def _scalar_rows(given: Sequence[Positions]) -> np.ndarray | None:
    """Values (n, k) of configurations that name the same joints in the same order, each a number; None of others."""
    if len(given) < 2:
        return None
    names = tuple(given[0])
    if any(tuple(one) != names for one in given):
        return None
    try:
        flat = np.fromiter(chain.from_iterable(one.values() for one in given), float, len(names) * len(given))
    except (TypeError, ValueError):  # a value is a list
        return None
    return flat.reshape(len(given), len(names))


def _of_rows(
    robot: RobotModel, columns: Mapping[str, tuple[int, ...]], rows: np.ndarray, field: str
) -> RobotConfigurations:
    """Configurations, shape (n, nq), of rows (n, k) whose columns are known by joint."""
    if len(far := np.argwhere(np.abs(rows) > LARGEST_VALUE)):
        row, column = far[0].tolist()
        name = next(name for name, at in columns.items() if column in at)
        raise InvalidConfiguration(
            f"`{field}[{row}]`: {name} may be {LARGEST_VALUE:g} at most, got {rows[row, column]:g}", joint=name, row=row
        )
    found = np.tile(robot.rest, (len(rows), 1))
    for joint in robot.joints:
        if (at := columns.get(joint.name)) is None:
            continue
        if joint.mimic is not None:
            raise InvalidConfiguration(
                f"joint {joint.name!r} follows {joint.mimic.source!r} and can't be given: give {joint.mimic.source!r}",
                joint=joint.name,
            )
        found[:, joint.idx_q : joint.idx_q + joint.nq] = _values(joint, rows[:, list(at)], field)
    _move_mimic_joints(robot.joints, found)
    return cast(RobotConfigurations, found)


def _values(joint: Joint, given: np.ndarray, field: str) -> np.ndarray:
    """A joint's part of configurations, shape (n, nq), of its columns."""
    if joint.kind in ANGLE:
        at = ANGLE[joint.kind]
        return np.column_stack([given[:, :at], np.cos(given[:, at]), np.sin(given[:, at])])
    if joint.kind in ROTATION:
        require_quaternions(joint, given, field)
        given[:, -4:] /= np.linalg.norm(given[:, -4:], axis=1, keepdims=True)
    return given


def _move_mimic_joints(joints: Sequence[Joint], configurations: np.ndarray) -> None:
    """Set mimic joints to what their source joints ask, in place; configurations of shape (n, nq)."""
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.mimic is None:
            continue
        source = by_name[joint.mimic.source]
        values = configurations[:, source.idx_q]
        if source.kind is JointKind.CONTINUOUS:
            values = np.arctan2(configurations[:, source.idx_q + 1], values)
        values = joint.mimic.multiplier * values + joint.mimic.offset
        configurations[:, joint.idx_q : joint.idx_q + joint.nq] = _values(joint, values[:, None], "")
