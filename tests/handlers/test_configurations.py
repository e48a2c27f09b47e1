"""Configurations in every form, and rows of a client's columns, are the same arrays and local coordinates."""

import msgspec
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

import guidefield
from guidefield.errors import InvalidConfiguration, MalformedRequest
from guidefield.handlers.configurations import (
    Columns,
    configurations_from,
    first_positions,
    local_points,
    local_rates,
    rates_from,
    require_same_joints,
    velocity_names_of,
    whole_group,
)
from guidefield.messages.conditions import ConfigurationTable
from guidefield.messages.values import Placement
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import POSITION_SUFFIXES, ROTATION, VELOCITY_SUFFIXES
from tests.robots import box_arm, grouped, load, robot

MIXED = box_arm("y floating planar y", 4)
FRAMES = {"type": "forward_kinematics", "robot": "panda", "frames": ["panda_hand"]}
JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
ROWS = np.array([[0.1, 0.2, 0.3, -1.5, 0.5, 1.6, 0.7], [0.0, -0.2, 0.1, -2.0, 0.1, 1.1, -0.7]])


def dicts(names: list[str], rows: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip(names, row, strict=True)) for row in rows.tolist()]


class TestForms:
    @pytest.mark.parametrize("name", ["panda", "allegro_right_hand", "double_pendulum_continuous"])
    def test_all_forms_are_what_one_configuration_after_the_other_is(self, name: str):
        model = robot(name)
        free = [joint for joint in model.joints if joint.mimic is None and joint.kind not in POSITION_SUFFIXES]
        names = [joint.name for joint in free]
        rows = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(names)))
        wanted = np.array([configuration_from_wire(model, one) for one in dicts(names, rows)])
        packed = ConfigurationTable(names, float64=rows.astype("<f8").tobytes())
        for form in (dicts(names, rows), ConfigurationTable(names, rows=rows.tolist()), packed):
            assert np.array_equal(configurations_from(model, form), wanted)
        turned = [*reversed(names)]
        other = ConfigurationTable(turned, rows=rows[:, ::-1].tolist())
        assert np.array_equal(configurations_from(model, other), wanted)
        mixed = dicts(names, rows)[:2] + dicts(names[:1], rows[:, :1])
        wanted = np.array([configuration_from_wire(model, one) for one in mixed])
        assert np.array_equal(configurations_from(model, mixed), wanted)

    def test_joints_of_several_coordinates(self):
        model = load(MIXED)
        values = {"j1": 0.4, "j2": [0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8], "j3": [1.0, 2.0, 0.5], "j4": -0.2}
        group = whole_group(model, Placement())
        row = [0.4, *values["j2"], *values["j3"], -0.2]
        table = ConfigurationTable(group.position_names, rows=[row])
        wanted = configuration_from_wire(model, values)
        assert configurations_from(model, table)[0] == pytest.approx(wanted, abs=1e-15)
        assert np.array_equal(configurations_from(model, [values])[0], wanted)

    def test_nothing_asked_is_nothing_answered(self):
        for form in ([], {"names": JOINTS, "rows": []}, {"names": JOINTS, "float64": b""}):
            assert guidefield.answer({**FRAMES, "configurations": form}).placements == []

    def test_a_table_is_the_same_through_json(self):
        asked = {**FRAMES, "configurations": {"names": JOINTS, "float64": ROWS.tobytes()}, "packed": True}
        listed = guidefield.answer({**FRAMES, "configurations": dicts(JOINTS, ROWS)})
        for request in (asked, msgspec.json.encode(asked)):
            packed = guidefield.answer(request).packed
            numbers = np.frombuffer(packed.float64, "<f8").reshape(packed.shape)
            assert numbers.shape == (2, 1, 7)
            for row, (placement,) in zip(numbers[:, 0], listed.placements, strict=True):
                assert row.tolist() == [*placement.position, *placement.quaternion_xyzw]


class TestRates:
    def test_forms_of_rates(self):
        group = whole_group(load(MIXED), Placement())
        rates = {"j1": 0.5, "j2": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "j3": [7.0, 8.0, 9.0]}
        flat = [0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 0.0]
        assert rates_from(group, [rates], "velocities")[0].tolist() == flat
        table = ConfigurationTable(group.velocity_names, rows=[flat])
        assert rates_from(group, table, "velocities")[0].tolist() == flat
        with pytest.raises(InvalidConfiguration, match=r"`velocities\[0\]`: joint 'j3' has 3 numbers, not 1"):
            rates_from(group, [{"j3": 1.0}], "velocities")


class TestFaults:
    @pytest.mark.parametrize(
        ("given", "told"),
        [
            ({"names": ["panda_joint1", "nose"], "rows": [[0.0, 1.0]]}, "`configurations.names` has 'nose'"),
            ({"names": ["panda_joint1"] * 2, "rows": [[0.0, 1.0]]}, "has 'panda_joint1' 2 times"),
            ({"names": ["panda_joint1"], "rows": [[0.0], [2e4]]}, r"`configurations.rows\[1\]`: panda_joint1 may be"),
            ([{"panda_joint1": 0.0}, {"panda_joint1": 2e4}], "joint 'panda_joint1': a value may be 10000 at most"),
            ([{"nose": 0.0}], "has no joint 'nose'"),
            ([{"panda_joint1": [0.0, 1.0]}], "its value is one number, not a list of 2"),
        ],
    )
    def test_what_does_not_fit_the_robot(self, given: object, told: str):
        with pytest.raises(InvalidConfiguration, match=told):
            guidefield.answer({**FRAMES, "configurations": given})

    @pytest.mark.parametrize(
        ("given", "told"),
        [
            ({"names": JOINTS}, "give either `rows` or `float64`"),
            ({"names": JOINTS, "rows": [[0.0]]}, r"`rows\[0\]` has 1 values, but there are 7 `names`"),
            ({"names": JOINTS[:2], "rows": [[0.0, np.nan]]}, r"`rows\[0\]\[1\]` must be a finite number, got nan"),
            ({"names": JOINTS, "float64": b"12345678"}, r"whole rows of 7 numbers \(56 bytes\), not 8"),
            (
                {"names": JOINTS[:2], "float64": np.array([0.0, 1.0, np.inf, 0.0]).tobytes()},
                r"`float64\[1\]\[0\]` must be a finite number, got inf",
            ),
        ],
    )
    def test_what_is_no_table(self, given: object, told: str):
        with pytest.raises(MalformedRequest, match=told):
            guidefield.answer({**FRAMES, "configurations": given})


SEEDS = st.integers(0, 2**32 - 1)
KINDS = ("x slide continuous", "planar y", "floating x", "x mimic", "continuous gear", "wide continuous planar")


def smooth(planned: PlanningGroup, seed: int, rows: int = 9) -> np.ndarray:
    """Local coordinates (n, nv) one next to the other, several turns long where angles have no limits."""
    rng = np.random.default_rng(seed)
    z = planned.to_local(planned.random(rng)) + np.cumsum(rng.uniform(-0.5, 0.9, size=(rows, planned.nv)), axis=0)
    for joint in planned.joints:  # a rotation vector stays shorter than a turn
        if joint.kind in ROTATION:
            at = slice(joint.idx_v + joint.nv - 3, joint.idx_v + joint.nv)
            z[:, at] *= 3.0 / max(3.0, np.linalg.norm(z[:, at], axis=1).max())
    return z


def columns_of(planned: PlanningGroup, names: list[str]) -> Columns:
    return Columns.named("position_names", names, planned.robot, POSITION_SUFFIXES)


def started_at(planned: PlanningGroup, columns: Columns, rows: np.ndarray) -> PlanningGroup:
    """The same group with the first row as its origin."""
    q = configuration_from_wire(planned.robot, first_positions(columns, rows, planned.robot))
    return select(planned.robot, [joint.name for joint in planned.joints], None, q, pin.SE3.Identity())


@settings(max_examples=12)
@given(seed=SEEDS, kinds=st.sampled_from(KINDS))
def test_columns_of_a_reply_in_any_order_are_the_same_motion(seed: int, kinds: str) -> None:
    planned = grouped(box_arm(kinds, 0))
    z = smooth(planned, seed)
    order = np.random.default_rng(seed).permutation(len(planned.position_names))
    rows = np.array([planned.wire_positions(point) for point in z])[:, order]
    columns = columns_of(planned, [planned.position_names[k] for k in order])
    placed = started_at(planned, columns, rows)
    found, warnings = local_points(columns, rows, placed, "path")
    assert warnings == []
    for point, given_ in zip(found, z, strict=True):
        np.testing.assert_allclose(placed.expand_from_local(point), planned.expand_from_local(given_), atol=1e-9)
    plain = [j.idx_v for j in planned.joints if j.nv == 1]
    np.testing.assert_array_equal(found[:, plain], z[:, plain])


@settings(max_examples=18)
@given(seed=SEEDS)
def test_angles_within_one_turn_go_the_shorter_way(seed: int) -> None:
    planned = grouped(box_arm("continuous x", 0))
    z = smooth(planned, seed, rows=20)
    wrapped = z.copy()
    wrapped[:, 0] = np.arctan2(np.sin(z[:, 0]), np.cos(z[:, 0]))
    columns = columns_of(planned, planned.position_names)
    found, warnings = local_points(columns, wrapped.copy(), planned, "path")
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(z, axis=0), atol=1e-9)
    assert len(warnings) == int(np.abs(np.diff(wrapped[:, 0])).max() > np.pi)


@settings(max_examples=18)
@given(seed=SEEDS, kinds=st.sampled_from(KINDS))
def test_velocities_are_tangents(seed: int, kinds: str) -> None:
    planned = grouped(box_arm(kinds, 0))
    z, rates = smooth(planned, seed), np.random.default_rng(seed).normal(size=(9, planned.nv))
    rows = np.array([planned.tangent_map(point) @ rate for point, rate in zip(z, rates, strict=True)])
    columns = Columns.named("velocity_names", planned.velocity_names, planned.robot, VELOCITY_SUFFIXES)
    np.testing.assert_allclose(local_rates(columns, rows, planned, z, "velocities"), rates, atol=1e-7)


def test_a_mimic_joint_may_have_a_column_that_says_what_its_law_says() -> None:
    planned = grouped(box_arm("x mimic", 0))
    columns = columns_of(planned, ["j2", "j1"])
    rows = np.array([[-0.5 * x + 0.2, x] for x in (0.0, 0.4, 1.0)])
    np.testing.assert_array_equal(local_points(columns, rows, planned, "path")[0], rows[:, 1:])
    rows[2, 0] += 0.01
    with pytest.raises(InvalidConfiguration, match=r"path\[2\].*'j2' follows 'j1'.*0.01 off"):
        local_points(columns, rows, planned, "path")
    assert velocity_names_of(columns, planned.robot) == ["j2", "j1"]
    rates = Columns.named("velocity_names", ["j2", "j1"], planned.robot, VELOCITY_SUFFIXES)
    assert local_rates(rates, np.array([[-0.5, 1.0]]), planned, rows[:1, 1:], "velocities").tolist() == [[1.0]]
    with pytest.raises(InvalidConfiguration, match="follows 'j1'"):
        local_rates(rates, np.array([[0.5, 1.0]]), planned, rows[:1, 1:], "velocities")


def test_a_mimic_joint_of_a_joint_without_a_column_stands_still() -> None:
    planned = grouped(box_arm("x mimic y", 0))
    alone = select(planned.robot, ["j3"], None, planned.robot.rest, pin.SE3.Identity())
    columns = columns_of(alone, ["j2", "j3"])
    assert local_points(columns, np.array([[0.2, 0.0], [0.2, 0.7]]), alone, "path")[0].tolist() == [[0.0], [0.7]]
    with pytest.raises(InvalidConfiguration, match=r"path\[1\].*follows 'j1'"):
        local_points(columns, np.array([[0.2, 0.0], [0.3, 0.7]]), alone, "path")


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (["j1", "j9"], "'j9'"),
        (["j1", "j1"], "2 times"),
        (["j1", "j2.x", "j2.y"], "lacks 'j2.theta'"),
        (["j1", "j2"], "'j2'"),
    ],
)
def test_names_that_are_no_columns_are_refused(names: list[str], why: str) -> None:
    with pytest.raises(InvalidConfiguration, match=why):
        Columns.named("position_names", names, load(box_arm("x planar", 0)), POSITION_SUFFIXES)


def test_rows_that_are_no_configurations_are_refused() -> None:
    planned = grouped(box_arm("floating x", 0))
    columns = columns_of(planned, planned.position_names)
    row = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.3]
    with pytest.raises(InvalidConfiguration, match=r"path\[1\].*norm 1, it has 1.1"):
        local_points(columns, np.array([row, [*row[:6], 1.1, 0.3]]), planned, "path")
    with pytest.raises(InvalidConfiguration, match=r"path\[1\].*j2 may be 10000"):
        local_points(columns, np.array([row, [*row[:7], 1e5]]), planned, "path")
    with pytest.raises(MalformedRequest, match="no column of joint 'j2'"):
        require_same_joints(
            columns, Columns.named("velocity_names", planned.velocity_names[:6], planned.robot, VELOCITY_SUFFIXES)
        )
