"""The spaces that arrays of joint values are in: one type for each, so that mypy refuses a point of another space.

A robot's joint values stand in several spaces. For a robot of revolute joints these have the same length and the same
numbers; a continuous joint, a ball joint or a joint that follows another tells them apart.

    RobotConfiguration  --part_of-->  Configuration  --expand-->  ModelConfiguration
                                      |  chart  ^                   ^
                                      v         |  from_chart       |  expand_from_chart
    a row of WireColumns  <--wire_positions--  ChartPoint  ---------+
                                               |
                                               +----------expand_chart-->  ModelChartPoint

`PlanningGroup` has these doors. Each type is an ndarray whose last axis is named after its space: a ChartPoint is no
Configuration, and several points are not a single one. A copy keeps its space, and so does what NumPy makes like
another array. What arithmetic, an index or a loop yields has no named axis: it fits everywhere, and the function that
returns or takes it says its space. Where NumPy's own type says too much, as of a new array, and where two spaces share
their numbers, `typing.cast` names the space. At run time all are plain arrays.
"""

from __future__ import annotations

from typing import NewType

import numpy as np

RobotAxis = NewType("RobotAxis", int)
ConfigurationAxis = NewType("ConfigurationAxis", int)
ModelAxis = NewType("ModelAxis", int)
ChartAxis = NewType("ChartAxis", int)
ChartRateAxis = NewType("ChartRateAxis", int)
ModelChartAxis = NewType("ModelChartAxis", int)
TangentAxis = NewType("TangentAxis", int)
WireAxis = NewType("WireAxis", int)

RobotConfiguration = np.ndarray[tuple[RobotAxis], np.dtype[np.float64]]
"""q of every joint of a robot, followers included, shape (robot.model.nq,) [rad, m, cosine and sine of a continuous or
planar joint's angle, or entries of a quaternion (x, y, z, w)]."""

RobotConfigurations = np.ndarray[tuple[int, RobotAxis], np.dtype[np.float64]]  # several, shape (n, robot.model.nq)

Configuration = np.ndarray[tuple[ConfigurationAxis], np.dtype[np.float64]]
"""q of a group's planned joints alone, shape (group.nq,), with the units of a `RobotConfiguration`."""

Configurations = np.ndarray[tuple[int, ConfigurationAxis], np.dtype[np.float64]]  # several, shape (n, group.nq)

ModelConfiguration = np.ndarray[tuple[ModelAxis], np.dtype[np.float64]]
"""q of a group's planned joints and those that follow them, shape (group.model.nq,): what Pinocchio and the kernels of
forward kinematics take. The same units."""

ModelConfigurations = np.ndarray[tuple[int, ModelAxis], np.dtype[np.float64]]  # several, shape (n, group.model.nq)

ChartPoint = np.ndarray[tuple[ChartAxis], np.dtype[np.float64]]
"""z of a group's planned joints, shape (group.nv,) [rad or m]: unwrapped angles, lengths and rotation vectors, in which
straight lines and splines are drawn (`robot/model/chart.py`)."""

ChartPoints = np.ndarray[tuple[int, ChartAxis], np.dtype[np.float64]]  # several, shape (n, group.nv)

ChartCurves = np.ndarray[tuple[int, int, ChartAxis], np.dtype[np.float64]]
"""Bezier curves in the chart, by their control points, shape (m, k, group.nv); k - 1 is their degree."""

ModelChartPoint = np.ndarray[tuple[ModelChartAxis], np.dtype[np.float64]]
"""z of a group's planned joints and those that follow them, shape (group.model.nv,) [rad or m]."""

ChartRate = np.ndarray[tuple[ChartRateAxis], np.dtype[np.float64]]
"""Derivatives of chart coordinates by time, of any order, or limits of theirs, shape (group.nv,) [rad/s or m/s, and so
on]. Where a joint has several freedoms they are no tangent (`PlanningGroup.tangent_map`)."""

ChartRates = np.ndarray[tuple[int, ChartRateAxis], np.dtype[np.float64]]
"""Several, or derivatives by a curve's parameter, shape (n, group.nv)."""


Tangent = np.ndarray[tuple[TangentAxis], np.dtype[np.float64]]
"""v of a group's planned joints, shape (group.nv,): what Pinocchio integrates, in the moved frame of each joint [rad or
m, or per s]."""

Tangents = np.ndarray[tuple[int, TangentAxis], np.dtype[np.float64]]
"""Several, or derivatives of theirs by time, shape (n, group.nv)."""


WireColumns = np.ndarray[tuple[int, WireAxis], np.dtype[np.float64]]
"""Positions as they travel, shape (n, len(group.position_names)): those of chart points, but quaternions (x, y, z, w)
for rotation vectors [rad, m, or entries of a quaternion]."""

WireRow = list[float]  # one row of them. A plain alias: messages hold lists of numbers

IndexedConfiguration = RobotConfiguration | Configuration
"""q of joints that say by their own indices where their values stand: a robot's, or a group's."""
