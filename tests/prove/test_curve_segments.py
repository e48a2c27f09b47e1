"""Parts of a motion that are judged together: all of it, in order, none too wide, however far it leads."""

from itertools import islice, pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.deadline import Deadline
from guidefield.prove.certificate import certify
from guidefield.prove.curve import restricted
from guidefield.prove.curve_segments import curve_segments, halved
from guidefield.prove.settings import CERTIFICATE
from guidefield.prove.verdict import Reason
from tests.collision.scenery import box, world_of
from tests.robots import box_arm, grouped

reaches = st.floats(-3.0, 1.0).map(lambda exponent: 10.0**exponent)


@given(st.lists(reaches, min_size=1, max_size=12), st.integers(2, 4), st.integers(0, 2**32 - 1))
def test_segments_are_the_whole_motion_in_order_and_none_is_wide(reach, points, seed):
    rng = np.random.default_rng(seed)
    pieces = np.array([size * rng.normal(size=(points, 3)) for size in reach])
    piece, at = 0, 0.0
    for segment in curve_segments(pieces):
        assert (segment.piece, segment.start) == (piece, at)
        several = len(segment.controls) > 1
        whole = pieces[piece : piece + len(segment.controls)]
        part = restricted(whole, np.array([segment.start] * len(whole)), np.array([segment.end] * len(whole)))
        assert segment.controls == pytest.approx(part, rel=0.0, abs=1e-9 * max(reach))
        assert np.ptp(segment.controls.reshape(-1, 3), axis=0).max() <= CERTIFICATE.widest
        assert not several or (segment.start, segment.end) == (0.0, 1.0)
        piece, at = (piece + len(segment.controls), 0.0) if segment.end == 1.0 else (piece, segment.end)
    assert (piece, at) == (len(pieces), 0.0)


@given(st.integers(1, 4), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_halves_are_the_curve_from_0_to_a_half_and_from_there_to_1(count, points, seed):
    curves = np.random.default_rng(seed).normal(size=(count, 2 * points, 3))[:, ::2]  # not one behind the other
    twice, start = np.repeat(curves, 2, axis=0), np.tile([0.0, 0.5], count)
    assert halved(curves) == pytest.approx(restricted(twice, start, start + 0.5), rel=0.0, abs=1e-12)


def test_a_motion_that_leads_far_is_divided_as_far_as_it_is_asked_for():
    far = np.array([[[0.0], [1e12]]] * 3)
    first = list(islice(curve_segments(far), 100))
    assert first[0].start == 0.0
    assert all(one.end == other.start for one, other in pairwise(first))


def test_a_judgement_of_a_motion_that_leads_far_is_ended_at_once():
    arm = grouped(box_arm("continuous", 1))
    world = world_of(arm, [box("far", [1.0, 1.0, 1.0], [50.0, 0.0, 0.0])])
    there = np.array([[np.full(arm.nv, -10_000.0), np.full(arm.nv, 10_000.0)]] * 100_000)
    asked = iter([None] * 3)
    verdict = certify(world, there, deadline=Deadline(is_cancelled=lambda: bool(next(asked, "time is up"))))
    assert verdict.reason is Reason.STOPPED
    assert verdict.evaluations <= 3 * CERTIFICATE.batch
