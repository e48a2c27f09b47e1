"""mypy tells the spaces apart: what says `refused` is, and nothing else."""

import os
import re
import subprocess
import sys
from pathlib import Path

HOUSE = Path(__file__).resolve().parents[3]

MIXED = """
import numpy as np

from guidefield.prove.certificate import certify, motion_free
from guidefield.collision.clearance import clearance_at
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.planner.motion.timing import PathCurve
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.curve import polyline
from guidefield.planner.path_so_far import PathSoFar
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, Configuration, ModelConfiguration


def doors(group: PlanningGroup, q: Configuration, z: ChartPoint, zs: ChartPoints, m: ModelConfiguration) -> None:
    group.from_chart(group.unwrapped(group.chart(q), z))
    group.from_chart(z + 0.5 * (zs[0] - z))
    group.expand(group.part_of(group.q_reference))
    group.wire_positions(group.chart_path([q], z)[0])
    group.chart(z)  # refused
    group.chart(z.copy())  # refused
    group.chart(m)  # refused
    group.chart(configuration_from_wire(group.robot, {}))  # refused
    group.from_chart(q)  # refused
    group.from_chart(zs)  # refused
    group.from_chart(group.expand_chart(z))  # refused
    group.expand(group.expand(q))  # refused
    group.unwrapped(z, q)  # refused
    group.part_of(q)  # refused
    group.wire_positions(q)  # refused


def judges(world: World, many: BatchCollision, group: PlanningGroup, q: Configuration, z: ChartPoint) -> None:
    clearance_at(world, group.expand_from_chart(z))
    clearance_at(world, group.expand(q))
    many.touching(np.array([z]))
    clearance_at(world, z)  # refused
    clearance_at(world, group.from_chart(z))  # refused
    clearance_at(world, group.expand_chart(z))  # refused
    world.in_collision(q)  # refused
    many.touching(z)  # refused
    Kinematics(group).tip_position(z)  # refused
    Kinematics(group).tip_position(q)  # refused


def planned(world: World, q: Configuration, z: ChartPoint, zs: ChartPoints) -> None:
    certify(world, polyline(zs))
    motion_free(world, zs[0], z)
    PathCurve.along(zs).at(np.zeros(1))
    Trajectory(np.zeros(1), zs, Trajectory(np.zeros(1), zs, zs).velocities)  # refused
    PathSoFar(zs).extend(z)  # refused
    PathSoFar(q)  # refused
    certify(world, zs)  # refused
    motion_free(world, q, z)  # refused


def plain(group: PlanningGroup, array: np.ndarray) -> None:
    group.chart(array)
    group.from_chart(array)
"""


def test_a_point_of_another_space_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mixed_spaces.py"
    file.write_text(MIXED)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "guidefield" / "mypy"  # as in tools/test
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--python-version", version]
    command += ["--cache-dir", str(cache), str(file)]
    told = subprocess.run(command, cwd=HOUSE, capture_output=True, text=True, check=False).stdout
    refused = [int(number) for number in re.findall(rf"{file.name}:(\d+): error: .*\[arg-type\]$", told, re.M)]
    expected = [number for number, line in enumerate(MIXED.splitlines(), 1) if line.endswith("# refused")]
    assert refused == expected, told
