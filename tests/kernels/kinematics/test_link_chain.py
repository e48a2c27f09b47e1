"""The chain's kernels against Pinocchio, finite differences and what closing has to keep."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st

from guidefield.kernels.kinematics.link_chain import chain_configuration, close_chain, end_force, turn_from
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.link_chain import SerialChain, link_chain
from tests.robots import group

CHAINS = (
    "chain_fixed_6x300_r25",
    "chain_moving_3x260_r20",
    "chain_universal_fixed_6x300_r25",
    "chain_universal_moving_6x200_r20",
)


def random_places(seed: int, links: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(links, 3))
    directions *= rng.uniform(0.1, 0.4, (links, 1)) / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.vstack([rng.normal(size=3), np.zeros((links, 3))]) + np.vstack(
        [np.zeros(3), np.cumsum(directions, axis=0)]
    )


def lengths(places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(places, axis=0), axis=1)


@settings(max_examples=12)
@given(seed=st.integers(0, 10**6), m=st.integers(2, 5), size=st.floats(0.0, 0.08))
@example(seed=82, m=3, size=0.078125)  # nearer to the first joint than the links can be folded
def test_a_closed_chain_ends_where_it_has_to_and_keeps_its_links(seed: int, m: int, size: float) -> None:
    places = random_places(seed)
    shift = np.random.default_rng(seed + 1).normal(size=3)
    target = places[m] + size * shift / np.linalg.norm(shift)
    whole, longest = lengths(places)[:m].sum(), lengths(places)[:m].max()
    # within what the links span, and not nearer to the first joint than the longest keeps all others away
    reachable = 2.0 * longest - whole < np.linalg.norm(target - places[0]) < 0.95 * whole
    closed = places.copy()
    if not close_chain(closed, m, target):
        assert not reachable or m == 2
        return
    np.testing.assert_allclose(closed[m], target, atol=2e-7)
    np.testing.assert_array_equal(closed[0], places[0])
    np.testing.assert_array_equal(closed[m + 1 :], places[m + 1 :])
    np.testing.assert_allclose(lengths(closed)[:m], lengths(places)[:m], rtol=1e-9)


@pytest.mark.parametrize("m", [1, 3, 5])
def test_the_end_force_does_the_virtual_work_of_closing(m: int) -> None:
    places = random_places(7)
    rng = np.random.default_rng(8)
    forces, torques = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    force = np.empty(3)
    end_force(places, forces, torques, m, force)
    for axis in np.eye(3):
        e = 1e-5 * (np.cross(axis, places[1] - places[0]) if m == 1 else axis)
        closed = places.copy()
        assert close_chain(closed, m, places[m] + e)
        before, after = np.diff(places, axis=0)[:m], np.diff(closed, axis=0)[:m]
        turns = np.cross(before, after) / np.einsum("ij,ij->i", before, before)[:, None]
        moved = closed[:m] - places[:m]  # the force on a link moves with its joint; the rest is its torque about it
        work = (forces[:m] * moved).sum() + (torques[:m] * turns).sum()
        np.testing.assert_allclose(force @ e, work, rtol=2e-3, atol=1e-9)


def at_random(chain: SerialChain, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = chain.group.random(np.random.default_rng(seed))
    return q, *chain.places(q)


def places_by_pinocchio(planned: PlanningGroup, chain: SerialChain, q: np.ndarray) -> np.ndarray:
    data = planned.model.createData()
    pin.forwardKinematics(planned.model, data, q)
    joints = [data.oMi[int(joint)] for joint in chain.carriers]
    return np.array([*(joint.translation for joint in joints), joints[-1].act(np.array(chain.table.links[-1]))])


@pytest.mark.parametrize("name", CHAINS)
def test_the_configuration_of_places_has_its_joints_there(name: str) -> None:
    planned = group(name)
    chain = link_chain(planned)
    for seed in range(10):
        q, places, rotations = at_random(chain, seed)
        np.testing.assert_allclose(places, places_by_pinocchio(planned, chain, q), atol=1e-12)
        moved = places.copy()
        for k in range(1, chain.n + 1):
            axis = np.random.default_rng([seed, k]).normal(size=3)
            turned = np.empty_like(moved)
            turn_from(moved, k, axis / np.linalg.norm(axis), 0.1, turned)
            moved = turned
        if chain.leads:
            moved += 0.05
        there, turned_rotations = np.empty_like(q), np.empty_like(rotations)
        assert chain_configuration(chain.table, moved, q, rotations, there, turned_rotations)
        np.testing.assert_allclose(places_by_pinocchio(planned, chain, there), moved, atol=1e-9)
        np.testing.assert_allclose(chain.places(there)[1], turned_rotations, atol=1e-9)
        assert np.linalg.norm(pin.difference(planned.model, q, there)) < 12.0
