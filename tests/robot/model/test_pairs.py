"""The rest configuration and link pairs: what always touches is left out, contacts are those of all pairs."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.messages.requests import UrdfText
from guidefield.robot.library import RobotCard
from guidefield.robot.model import pairs
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.pairs import SelfContacts, scratch_space
from guidefield.robot.model.rest import stated
from guidefield.robot.urdf.srdf import Srdf
from tests.robots import load, robot


@pytest.mark.parametrize("name", ["ur5"])
def test_the_pairs_that_always_touch_are_those_that_do_at_all_samples(name: str) -> None:
    model = robot(name)
    geometry = model.geometry.copy()
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()
    links = [model.link_of_geometry(index) for index in range(len(geometry.geometryObjects))]
    names = [frozenset((links[pair.first], links[pair.second])) for pair in geometry.collisionPairs]
    disabled = set(names[::7])
    found = pairs._shares_touching(model.model, geometry, model.joints, links, model.rest, disabled, model.size)
    data, geometry_data = model.model.createData(), scratch_space(geometry)
    for request in geometry_data.collisionRequests:
        request.security_margin = pairs.TOUCH_DISTANCE
    counts, rng = dict.fromkeys(names, 0), np.random.default_rng(0)
    for q in [
        model.rest,
        *(pairs.random_configuration(model.model, model.joints, rng, model.size) for _ in range(pairs.SAMPLES)),
    ]:
        pin.computeCollisions(model.model, data, geometry, geometry_data, q, False)
        results = zip(names, geometry_data.collisionResults, strict=True)
        for pair in {pair for pair, result in results if result.isCollision()}:
            counts[pair] += 1
    shares = {pair: count / (pairs.SAMPLES + 1) for pair, count in counts.items()}
    assert {pair for pair in shares if shares[pair] > pairs.ALWAYS_SHARE} == {
        pair for pair in found if found[pair] > pairs.ALWAYS_SHARE
    }
    assert any(share > pairs.ALWAYS_SHARE for share in shares.values())
    assert {pair: found.get(pair, 0.0) for pair in disabled} == {pair: shares[pair] for pair in disabled}


def separation(first: pin.SE3, second: pin.SE3, half: np.ndarray) -> float:
    """Largest gap of two equal boxes along an axis that could separate them [m]; negative if they overlap."""
    own = [*first.rotation.T, *second.rotation.T]
    axes = own + [np.cross(a, b) for a in first.rotation.T for b in second.rotation.T]
    gaps = []
    for axis in axes:
        length = float(np.linalg.norm(axis))
        if length > 1e-9:
            n = axis / length
            extents = np.abs(first.rotation.T @ n) @ half + np.abs(second.rotation.T @ n) @ half
            gaps.append(abs(n @ (second.translation - first.translation)) - extents)
    return max(gaps)


def test_two_boxes_that_turn_about_one_axis_touch_where_their_axes_say_so() -> None:
    size = np.array([0.03, 0.03, 0.04])
    model, geometry = pin.Model(), pin.GeometryModel()
    for name in ("a", "b"):
        joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), name)
        offset = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.025]))
        geometry.addGeometryObject(pin.GeometryObject(name, joint, offset, coal.Box(*size)))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    data, scratch = model.createData(), scratch_space(geometry)
    rng = np.random.default_rng(0)
    for q in rng.uniform(-np.pi, np.pi, (2000, 2)):
        touching = pin.computeCollisions(model, data, geometry, scratch, q, True)
        gap = separation(scratch.oMg[0], scratch.oMg[1], size / 2.0)
        assert touching == (gap < 0.0) or abs(gap) < 1e-6, (q, gap)


@pytest.mark.parametrize("name", ["panda", "ur5", "baxter", "talos_reduced"])
@pytest.mark.parametrize("margin", [0.0, 0.02])
def test_contacts_are_those_of_all_pairs(name: str, margin: float) -> None:
    model = robot(name)
    geometry = model.geometry.copy()
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()
    data, geometry_data = model.model.createData(), scratch_space(geometry)
    for request in geometry_data.collisionRequests:
        request.security_margin = margin
    contacts, rng = SelfContacts(model.model, geometry), np.random.default_rng(5)
    touching = 0
    for _ in range(10):
        q = pairs.random_configuration(model.model, model.joints, rng, model.size)
        pin.computeCollisions(model.model, data, geometry, geometry_data, q, False)
        expected = {k for k, result in enumerate(geometry_data.collisionResults) if result.isCollision()}
        contacts.place(q)
        assert set(contacts.find_contacts(margin)) == expected
        touching += len(expected)
    assert touching > 10
    assert contacts.exact_tests < 0.6 * 10 * len(geometry.collisionPairs)


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
