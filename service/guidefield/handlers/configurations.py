"""Configurations and rates of kinematics requests as arrays, checked: a table's columns, or lists, all rows at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import cast

import numpy as np

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.errors import InvalidConfiguration, at_path
from guidefield.geometry.placements import se3
from guidefield.handlers.given_columns import Columns, require_quaternions, rows_in
from guidefield.messages.kinematics_replies import PackedNumbers
from guidefield.messages.kinematics_requests import ConfigurationBatch, ConfigurationTable, JointRates
from guidefield.messages.requests import Positions
from guidefield.messages.values import Placement
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model import chart
from guidefield.robot.model.configuration import FURTHEST, configuration_from_wire
from guidefield.robot.model.model import Joint, JointKind, RobotModel
from guidefield.robot.model.spaces import ModelConfigurations, RobotConfigurations

CONFIGURATIONS_PER_CHECK = 16
"""Configurations answered between two looks at the deadline: with the slowest robots a few milliseconds."""


def configurations_from(robot: RobotModel, given: ConfigurationBatch) -> RobotConfigurations:
    """Return configurations of the whole robot, mimic joints included, shape (n, nq).

    Raises InvalidConfiguration if a joint is unknown or a mimic joint, or a value doesn't fit it.
    """
    if isinstance(given, ConfigurationTable):
        rows = rows_in(given.rows) if given.rows else _unpacked(given)
        columns = Columns.named("configurations.names", given.names, robot, chart.POSITION_SUFFIXES)
        return _of_rows(robot, columns.of, rows, "configurations.rows")
    if (values := _scalar_rows(given)) is not None:
        with at_path("$.configurations[0]"):
            configuration_from_wire(robot, given[0])  # every fault of a name is found in the first
        if np.abs(values).max(initial=0.0) <= FURTHEST:
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
    """Check the deadline after some configurations, poses or points of those that were asked.

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
        columns = Columns.named(f"{field}.names", given.names, robot, chart.VELOCITY_SUFFIXES)
        rows = rows_in(given.rows) if given.rows else _unpacked(given)
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


def _unpacked(table: ConfigurationTable) -> np.ndarray:
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
    if len(far := np.argwhere(np.abs(rows) > FURTHEST)):
        row, column = far[0].tolist()
        name = next(name for name, at in columns.items() if column in at)
        raise InvalidConfiguration(
            f"`{field}[{row}]`: {name} may be {FURTHEST:g} at most, got {rows[row, column]:g}", joint=name, row=row
        )
    found = np.tile(robot.rest, (len(rows), 1))
    for joint in robot.joints:
        if (at := columns.get(joint.name)) is None:
            continue
        if joint.mimic is not None:
            raise InvalidConfiguration(
                f"joint {joint.name!r} follows {joint.mimic.driver!r} and can't be given: give {joint.mimic.driver!r}",
                joint=joint.name,
            )
        found[:, joint.idx_q : joint.idx_q + joint.nq] = _values(joint, rows[:, list(at)], field)
    _move_mimic_joints(robot.joints, found)
    return cast(RobotConfigurations, found)


def _values(joint: Joint, given: np.ndarray, field: str) -> np.ndarray:
    """A joint's part of configurations, shape (n, nq), of its columns."""
    if joint.kind in chart.ANGLE:
        at = chart.ANGLE[joint.kind]
        return np.column_stack([given[:, :at], np.cos(given[:, at]), np.sin(given[:, at])])
    if joint.kind in chart.ROTATION:
        require_quaternions(joint, given, field)
        given[:, -4:] /= np.linalg.norm(given[:, -4:], axis=1, keepdims=True)
    return given


def _move_mimic_joints(joints: Sequence[Joint], configurations: np.ndarray) -> None:
    """Set mimic joints to what their source joints ask, in place; configurations of shape (n, nq)."""
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.mimic is None:
            continue
        source = by_name[joint.mimic.driver]
        values = configurations[:, source.idx_q]
        if source.kind is JointKind.CONTINUOUS:
            values = np.arctan2(configurations[:, source.idx_q + 1], values)
        values = joint.mimic.multiplier * values + joint.mimic.offset
        configurations[:, joint.idx_q : joint.idx_q + joint.nq] = _values(joint, values[:, None], "")
