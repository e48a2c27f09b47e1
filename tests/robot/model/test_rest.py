"""The rest configuration is free of contact wherever one near what was stated is."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.messages.requests import UrdfText
from guidefield.robot.library import RobotCard
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.rest import stated
from guidefield.robot.urdf.srdf import Srdf
from tests.robots import load, robot

LINK = '<link name="{name}"><collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision></link>'
JOINT = (
    '<joint name="{name}" type="revolute"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
    '<axis xyz="0 1 0"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>'
)


def folded(lower: float, upper: float) -> UrdfText:
    """A forearm that lies in the base's block where the elbow is at zero, and leaves it as that turns."""
    parts = [
        LINK.format(name="base", at="0 0 0.1", size="0.1 0.1 0.2"),
        LINK.format(name="upper", at="0.3 0 0.2", size="0.2 0.02 0.02"),
        LINK.format(name="fore", at="-0.25 0 0", size="0.5 0.02 0.02"),
        JOINT.format(name="shoulder", at="0 0 0", parent="base", child="upper", lower=-0.01, upper=0.01),
        JOINT.format(name="elbow", at="0.4 0 0.15", parent="upper", child="fore", lower=lower, upper=upper),
    ]
    return UrdfText(text=f'<robot name="folded">{"".join(parts)}</robot>')


def touching(model: RobotModel, q: np.ndarray) -> bool:
    data, geometry_data = model.model.createData(), model.geometry.createData()
    return bool(pin.computeCollisions(model.model, data, model.geometry, geometry_data, q, True))


def test_a_zero_that_touches_is_left_for_a_free_configuration_nearby():
    model = load(folded(-2, 2))
    assert touching(model, np.zeros(2))
    assert not touching(model, model.rest)
    assert 0.05 < abs(model.rest[1]) < 1.2
    assert any("base and fore touch in the rest configuration as stated or zero" in told for told in model.warnings)
    assert np.array_equal(load(UrdfText(text=folded(-2, 2).text + " ")).rest, model.rest), "the same each time"


def test_links_that_touch_wherever_they_are_are_left_out_with_that_reason():
    model = load(folded(-0.02, 0.02))
    (pair,) = [pair for pair in model.pairs_left_out if set(pair.links) == {"base", "fore"}]
    assert pair.reason == "touching in 100 % of random configurations"
    assert not touching(model, model.rest)


@pytest.mark.parametrize("name", ["icub", "icub_reduced", "panda", "ur5", "xarm7", "kinova"])
def test_what_a_card_states_stays(name):
    assert not touching(robot(name), robot(name).rest)
    assert not any("touch in the rest configuration" in told for told in robot(name).remarks)


def test_a_value_of_a_card_beyond_its_limits_is_warned_of():
    model = load(folded(-2, 2))
    card = RobotCard(urdf="", rest={"shoulder": 0.005, "elbow": 3.0})
    warnings: list[str] = []
    found = stated(model.model, model.joints, Srdf(), card, warnings)
    assert found.q.tolist() == [0.005, 2.0]
    assert warnings == ["the card's rest value of 'elbow' is beyond its limits: it has the limit instead"]
