"""How far points get near a straight way: never beyond the bound, which is below that of the box about the way."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.closing import Ways
from guidefield.robot.group.tangents import tangents
from tests.collision.listed import listed
from tests.collision.test_motion_bound import ARMS, bounds_at, random_box, travels, world
from tests.collision.test_world import pair_distances


def bounds_near(place, middle, chord, off):
    """For every pair, at the middle of a straight way."""
    planned, movers = place.group, place.pairs.links + np.arange(place.pairs.n_self)
    jacobian = pin.computeJointJacobians(place.model, place.data, planned.expand_from_chart(middle)).reshape(1, 6, -1)
    centres = place.bodies.centres_in_world(place.joint_placements)[None]
    moves = tangents(planned, middle[None], chord[None]) @ planned.expand_velocity.T
    reach = place.motion_bound.reach(jacobian, centres)
    ways = Ways(jacobian, centres, reach, chord[None], moves, off[None])
    movers = np.concatenate([movers, listed(place)[place.pairs.n_self :, 0]])
    return place.closing.beside(ways, np.zeros(len(movers), int), movers)


def near_chord(rng, middle, chord, off):
    """Points near the way, its ends among them."""
    along, beside = rng.uniform(-1, 1, (8, 1)), rng.choice([-1.0, 1.0], (8, len(middle)))
    along[:4] = np.sign(along[:4])
    return middle + along * chord + beside * off


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.5]))
def test_no_point_near_a_way_gets_further_than_the_bound(name, seed, share):
    place, rng = world(name), np.random.default_rng(seed)
    middle, widths = random_box(place, rng)
    chord, off = widths * rng.choice([-1.0, 1.0], len(widths)), share * widths
    bounds = bounds_near(place, middle, chord, off)[place.pairs.n_self :]
    for z in near_chord(rng, middle, chord, off):
        moved = travels(place, middle, z)[listed(place)[place.pairs.n_self :, 0]]
        assert (moved <= bounds + 1e-9).all()


@settings(deadline=None, max_examples=30)
@given(st.sampled_from(sorted(ARMS.keys() - {"kinova"})), st.integers(0, 10**6), st.sampled_from([0.0, 0.1]))
def test_no_pair_near_a_way_comes_closer_by_more_than_the_bound(name, seed, share):
    place, rng = world(name), np.random.default_rng(seed)
    middle, widths = random_box(place, rng)
    chord, off, planned = widths * rng.choice([-1.0, 1.0], len(widths)), share * widths, place.group
    bounds = bounds_near(place, middle, chord, off)
    before = np.maximum(pair_distances(place, planned.from_chart(middle)), 0.0)
    for z in near_chord(rng, middle, chord, off)[2:6]:
        after = np.maximum(pair_distances(place, planned.from_chart(z)), 0.0)
        assert (before - after <= bounds + 2e-6).all()


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_joints_that_turn_against_one_another_move_less_than_their_box_says(name):
    place, rng = world(name), np.random.default_rng(4)
    ratios = []
    for _ in range(20):
        middle = random_box(place, rng)[0]
        chord = rng.uniform(-0.03, 0.03, place.group.nv)
        near, box = bounds_near(place, middle, chord, 0.0 * chord), bounds_at(place, middle, np.abs(chord))
        ratios += (near[box > 0.0] / box[box > 0.0]).tolist()
    assert np.median(ratios) < 0.8
