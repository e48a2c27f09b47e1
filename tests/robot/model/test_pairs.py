"""Link pairs: those that always touch are left out, contacts are those of all pairs, whatever was asked before."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.robot.model import pairs
from guidefield.robot.model.pairs import SelfContacts, scratch_space
from tests.robots import robot


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
