"""What bodies lose along a motion: never more than the bounds, which are those of their formulas, written out."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.kernels.certificate.losses import find_losses
from guidefield.prove.certified_tables import certified_robot
from guidefield.robot.group.tangents import tangents
from tests.collision.listed import listed
from tests.collision.test_motion_bound import ARMS, bounds_at, random_box, travels, world
from tests.collision.test_world import pair_distances


class Part(NamedTuple):
    """A part of a motion: in a box about its middle, and near a straight way through it."""

    middle: np.ndarray
    widths: np.ndarray
    chord: np.ndarray
    off: np.ndarray


def found(place, parts):
    """For every pair, in each part: shape (s, pairs)."""
    robot, group, model, data = certified_robot(place), place.group, place.model, place.data
    middles, widths, chords, off = (np.array(rows) for rows in zip(*parts, strict=True))
    jacobians, joints = np.empty((len(parts), 6, model.nv)), np.empty((len(parts), model.njoints, 3, 4))
    for row, middle in enumerate(middles):
        jacobians[row] = pin.computeJointJacobians(model, data, group.expand_from_chart(middle)).reshape(6, -1)
        joints[row] = place.joint_placements
    moves = tangents(group, middles, chords) @ group.expand_velocity.T
    centres, own = np.empty((len(parts), len(robot.radii), 3)), np.empty((len(parts), len(robot.own)))
    mixed = np.empty(centres.shape[:2])
    find_losses(robot, jacobians, joints.reshape(len(parts), -1, 12), widths, chords, moves, off, centres, own, mixed)
    assert centres == pytest.approx(place.bodies.centres_in_world(joints), abs=1e-12)
    return np.concatenate([own, mixed[:, listed(place)[place.pairs.n_self :, 0]]], axis=1)


def near_chord(rng, part):
    """Points near the way and in the box, its ends among them."""
    along, beside = rng.uniform(-1, 1, (8, 1)), rng.choice([-1.0, 1.0], (8, len(part.middle)))
    along[:4] = np.sign(along[:4])
    return part.middle + along * part.chord + beside * part.off


def random_part(place, rng, share):
    middle, widths = random_box(place, rng)
    chord, off = widths * rng.choice([-1.0, 1.0], len(widths)), share * widths
    return Part(middle, np.abs(chord) + off, chord, off)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6), st.sampled_from([0.0, 0.02, 0.5]))
def test_no_point_near_a_way_gets_further_than_the_bound(name, seed, share):
    place, rng = world(name), np.random.default_rng(seed)
    part = random_part(place, rng, share)
    bounds = found(place, [part])[0, place.pairs.n_self :]
    for z in near_chord(rng, part):
        moved = travels(place, part.middle, z)[listed(place)[place.pairs.n_self :, 0]]
        assert (moved <= bounds + 1e-9).all()


@settings(deadline=None, max_examples=30)
@given(st.sampled_from(sorted(ARMS.keys() - {"kinova"})), st.integers(0, 10**6), st.sampled_from([0.0, 0.1]))
def test_no_pair_near_a_way_comes_closer_by_more_than_the_bound(name, seed, share):
    place, rng = world(name), np.random.default_rng(seed)
    part, planned = random_part(place, rng, share), place.group
    bounds = found(place, [part])[0]
    before = np.maximum(pair_distances(place, planned.from_chart(part.middle)), 0.0)
    for z in near_chord(rng, part)[2:6]:
        after = np.maximum(pair_distances(place, planned.from_chart(z)), 0.0)
        assert (before - after <= bounds + 2e-6).all()


def beside(place, part):
    """The formula for a part near its way, joint after joint, for each body, shape (r,)."""
    group, bound, model, data = place.group, place.motion_bound, place.model, place.data
    jacobian = pin.computeJointJacobians(model, data, group.expand_from_chart(part.middle)).reshape(6, -1)
    centres = place.bodies.centres_in_world(place.joint_placements)
    reach = bound.reach(jacobian[None], centres[None])[0]
    moves = (tangents(group, part.middle[None], part.chord[None]) @ group.expand_velocity.T)[0]
    v, way, off = bound.spread(part.chord[None])[0], bound.sweep(part.chord[None])[0], bound.sweep(part.off[None])[0]
    bounds = []
    for body, centre in enumerate(centres):
        joints = np.flatnonzero(bound.moved_by[body])
        linear, angular = (jacobian[rows][:, joints] @ moves[joints] for rows in (slice(0, 3), slice(3, 6)))
        speed = np.linalg.norm(linear + np.cross(angular, centre)) + np.linalg.norm(angular) * place.bodies.radii[body]
        farther = sum(reach[body, i] * way[i] for i in joints)
        whole, turned = speed, 0.0
        for j in joints:
            rho = reach[body, j] + (farther if bound.turns[j] else 0.0)
            whole += 0.5 * rho * v[j] * (2.0 * turned + bound.doubled[j] * v[j]) + rho * off[j]
            turned += v[j] if bound.turns[j] else 0.0
        bounds.append(whole)
    return np.array(bounds)


@pytest.mark.parametrize("name", sorted(ARMS))
def test_the_bounds_are_those_of_the_formulas(name):
    place, rng = world(name), np.random.default_rng(5)
    parts = [random_part(place, rng, share) for share in (0.0, 0.02, 0.5)]
    own = place.pairs.n_self
    for part, bounds in zip(parts, found(place, parts), strict=True):
        box, bodies = bounds_at(place, part.middle, part.widths), listed(place)[own:, 0]
        assert (bounds <= box + 1e-9).all()
        assert bounds[own:] == pytest.approx(np.minimum(box[own:], beside(place, part)[bodies]), rel=1e-7, abs=1e-9)
    still = [Part(part.middle, part.widths, 0.0 * part.chord, part.widths) for part in parts]  # no way: the box alone
    for part, bounds in zip(still, found(place, still), strict=True):
        assert bounds == pytest.approx(bounds_at(place, part.middle, part.widths), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_joints_that_turn_against_one_another_move_less_than_their_box_says(name):
    place, rng = world(name), np.random.default_rng(4)
    ratios = []
    for _ in range(20):
        middle = random_box(place, rng)[0]
        chord = rng.uniform(-0.03, 0.03, place.group.nv)
        part = Part(middle, np.abs(chord), chord, 0.0 * chord)
        near, box = found(place, [part])[0], bounds_at(place, middle, np.abs(chord))
        ratios += (near[box > 0.0] / box[box > 0.0]).tolist()
    assert np.median(ratios) < 0.8
