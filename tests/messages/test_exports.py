"""Motions as files for controllers, read by others' readers: PyYAML, csv, json, NumPy, and a parser of URScript."""

import csv
import io
import itertools
import json
import re
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st

from guidefield.errors import MalformedRequest
from guidefield.messages.execution import KINDS, ExecutionFigures, MotionDeviation, export

JOINTS = ["pan", "lift", "elbow", "wrist 1", "wrist:2", "yes"]
NO_DEVIATION = MotionDeviation(largest=0.0, joint="pan", time=0.0, joints={})


def rows(interpolation: str, count: int = 5, seed: int = 0, begin: float = 0.0) -> ExecutionFigures:
    rng = np.random.default_rng(seed)
    times = begin + np.cumsum(rng.uniform(1e-6, 0.1, count))
    if "hold" in interpolation:
        times = begin + np.arange(count) * 0.008
    tables = rng.normal(size=(3, count, len(JOINTS))) * 10.0 ** rng.integers(-12, 3, (3, count, 1))
    return ExecutionFigures(
        interpolation=interpolation,
        rate=125.0,
        tolerance=[0.002] * len(JOINTS),
        deviation=NO_DEVIATION,
        times=times.tolist(),
        positions=tables[0].tolist(),
        velocities=tables[1].tolist() if interpolation in ("cubic", "quintic") else None,
        accelerations=tables[2].tolist() if interpolation == "quintic" else None,
        end=float(times[-1]),
    )


def written(given_rows: ExecutionFigures, kind: str) -> bytes:
    return export("r1", JOINTS, given_rows, kind)


def require_same(message: dict[str, Any], given_rows: ExecutionFigures) -> None:
    assert message["joint_names"] == JOINTS
    points = message["points"]
    stamps = [point["time_from_start"]["sec"] * 10**9 + point["time_from_start"]["nanosec"] for point in points]
    assert stamps[0] == 0
    assert all(b > a for a, b in itertools.pairwise(stamps))
    np.testing.assert_allclose(np.array(stamps) * 1e-9, np.array(given_rows.times) - given_rows.times[0], atol=1e-9)
    assert all(0 <= point["time_from_start"]["nanosec"] < 10**9 for point in points)
    for name in ("positions", "velocities", "accelerations"):
        wanted = getattr(given_rows, name)
        assert [point.get(name) for point in points] == (wanted or [None] * len(points))


@settings(max_examples=20)
@given(st.sampled_from(["linear", "cubic", "quintic"]), st.integers(0, 10**6), st.sampled_from([0.0, 3.0, 2e6]))
def test_ros_reads_the_very_rows(interpolation: str, seed: int, begin: float) -> None:
    given_rows = rows(interpolation, seed=seed, begin=begin)
    text = written(given_rows, "yaml")
    require_same(yaml.safe_load(text)["trajectory"], given_rows)
    assert f"certified for: {interpolation}" in text.decode().splitlines()[0]
    goal = json.loads(written(given_rows, "ros.json"))
    require_same(goal["trajectory"], given_rows)
    assert interpolation in goal["certified_for"]


@pytest.mark.parametrize("interpolation", ["linear", "quintic", "zero_order_hold"])
def test_tables_are_read_to_the_last_digit(interpolation: str) -> None:
    given_rows = rows(interpolation)
    first, *lines = written(given_rows, "csv").decode().splitlines()
    assert first.startswith(f"# certified for: {interpolation} at 125 Hz, within 0.002")
    table = [*csv.DictReader(io.StringIO("\n".join(lines)))]
    plain = json.loads(written(given_rows, "json"))
    with np.load(io.BytesIO(written(given_rows, "npz")), allow_pickle=False) as arrays:
        assert arrays["interpolation"] == interpolation == plain["interpolation"]
        assert arrays["position_names"].tolist() == JOINTS == plain["position_names"]
        assert float(arrays["rate"]) == 125.0
        assert arrays["times"].tolist() == [float(row["time"]) for row in table] == given_rows.times == plain["times"]
        for kind, name in (("position", "positions"), ("velocity", "velocities"), ("acceleration", "accelerations")):
            wanted = getattr(given_rows, name)
            if wanted is None:
                assert name not in arrays.files
                assert name not in plain
                assert f"{kind}:pan" not in table[0]
                continue
            assert arrays[name].tolist() == wanted == plain[name]
            assert [[float(row[f"{kind}:{joint}"]) for joint in JOINTS] for row in table] == wanted


def read_servoj(script: str) -> tuple[list[list[float]], set[float]]:
    """The commands of a program and their steps; every line has to be a statement that is known here."""
    commands, steps, depth = [], set(), 0
    number = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
    row = rf"\[{number}(?:, {number}){{5}}\]"
    for line in script.splitlines():
        text = line.strip()
        if text.startswith("#"):
            continue
        if command := re.fullmatch(rf"servoj\(({row}), 0, 0, ({number}), ({number}), ({number})\)", text):
            assert depth == 1
            commands.append(json.loads(command[1]))
            steps.add(float(command[2]))
            assert 0.03 <= float(command[3]) <= 0.2
            assert 100 <= float(command[4]) <= 2000
        elif re.fullmatch(r"def \w+\(\):|while .+:|if .+:", text):
            depth += 1
        elif text == "end":
            depth -= 1
        else:
            assert re.fullmatch(rf"\w+ = ({row}|\w+\(\)|\d+|joint \+ 1)|halt|popup\(.+\)|\w+\([\d.]*\)", text), text
    assert depth == 0
    return commands, steps


@pytest.mark.parametrize("interpolation", ["zero_order_hold", "first_order_hold"])
def test_a_script_has_a_command_for_each_tick(interpolation: str) -> None:
    given_rows = rows(interpolation, count=40)
    commands, steps = read_servoj(written(given_rows, "script").decode())
    assert commands == given_rows.positions
    assert steps == {0.008}


@pytest.mark.parametrize(
    ("interpolation", "kind", "said"),
    [
        ("zero_order_hold", "yaml", "draws it as 'linear', 'cubic' or 'quintic'"),
        ("first_order_hold", "ros.json", "'first_order_hold'"),
        ("quintic", "script", "certified for 'quintic'"),
        ("linear", "script", "movej"),
        ("linear", "xml", "not as 'xml'"),
    ],
)
def test_another_interpolation_is_refused_by_name(interpolation: str, kind: str, said: str) -> None:
    with pytest.raises(MalformedRequest, match=said):
        written(rows(interpolation), kind)


def test_what_no_controller_takes_is_refused_by_name() -> None:
    for kind in KINDS:
        with pytest.raises(MalformedRequest, match="'r1' is not certified for a controller"):
            export("r1", JOINTS, None, kind)
    with pytest.raises(MalformedRequest, match="moves 6 joints"):
        export("r1", [*JOINTS, "seventh"], rows("zero_order_hold"), "script")
    with pytest.raises(MalformedRequest, match="500 Hz"):
        written(msgspec.structs.replace(rows("zero_order_hold"), rate=1000.0), "script")
    close = msgspec.structs.replace(rows("cubic"), times=[0.0, 1e-10, 0.1, 0.2, 0.3])
    with pytest.raises(MalformedRequest, match="row 1 is less than a nanosecond"):
        written(close, "yaml")


@pytest.mark.parametrize(
    "name", ['a "q"', "car\rriage", "new\nline\n  movej(0)\n#", "\U0001f600", "\u2028", "it's: {x}, #", "\x7f\\"]
)
def test_a_name_is_a_name_in_every_kind(name: str) -> None:
    """It adds no line to a program, and is read as it was."""
    joints = ["pan", name, *JOINTS[2:]]
    program = export("r", joints, rows("zero_order_hold"), "script").decode()
    assert program.count("\n") == written(rows("zero_order_hold"), "script").count(b"\n")
    assert program.isascii()
    read = yaml.safe_load(export("r", joints, rows("quintic"), "yaml"))
    assert read["trajectory"]["joint_names"] == joints
    assert json.loads(export("r", joints, rows("quintic"), "ros.json"))["trajectory"]["joint_names"] == joints
    table = export("r", joints, rows("linear"), "csv").decode().partition("\n")[2]
    assert next(csv.reader(io.StringIO(table, newline="")))[2] == f"position:{name}"
