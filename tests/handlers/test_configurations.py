"""Configurations in every form of a request are the same array."""

import msgspec
import numpy as np
import pytest

import guidefield
from guidefield.errors import InvalidConfiguration, MalformedRequest
from guidefield.handlers.configurations import configurations_from, rates_from, whole_group
from guidefield.messages.conditions import ConfigurationTable
from guidefield.messages.values import Placement
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import POSITION_SUFFIXES
from tests.robots import box_arm, load, robot

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
        for given in (dicts(names, rows), ConfigurationTable(names, rows=rows.tolist()), packed):
            assert np.array_equal(configurations_from(model, given), wanted)
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
        for given in ([], {"names": JOINTS, "rows": []}, {"names": JOINTS, "float64": b""}):
            assert guidefield.answer({**FRAMES, "configurations": given}).placements == []

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
