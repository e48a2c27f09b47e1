"""What is certified straight is straight at dense samples, on random curves about random straight ways."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from tests.planner.problems import scene_of
from tests.robots import group

from guidefield.collision.world import World
from guidefield.planner.sequence.straight_way import StraightWay, certify_straight
from guidefield.prove.verdict import Reason
from guidefield.robot.group.kinematics import Kinematics

SEEDS = st.integers(0, 2**32 - 1)


def off(way: StraightWay, placement: pin.SE3) -> tuple[float, float]:
    """Distance from the segment, and angle from the even turning there, by formulas of their own [m, rad]."""
    along = way.end.translation - way.begin.translation
    share = 0.0
    if along @ along > 0.0:
        share = float((placement.translation - way.begin.translation) @ along / (along @ along))
    inside = float(np.clip(share, 0.0, 1.0))
    nearest = way.begin.translation + inside * along
    even = way.begin.rotation @ pin.exp3(share * pin.log3(way.begin.rotation.T @ way.end.rotation))
    cosine = 0.5 * (np.trace(even.T @ placement.rotation) - 1.0)
    return float(np.linalg.norm(placement.translation - nearest)), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


@given(SEEDS, st.sampled_from(["panda", "ur5"]), st.floats(-3.0, -0.5))
def test_what_is_certified_is_within_its_tolerances_at_dense_samples(seed: int, name: str, size: float) -> None:
    rng = np.random.default_rng(seed)
    arm = group(name)
    kinematics, span = Kinematics(arm), 10.0**size
    middle = arm.chart(arm.random(rng))
    direction = rng.standard_normal(arm.nv)
    straight = middle + np.linspace(-1.0, 1.0, 4)[:, None] * span * direction / np.linalg.norm(direction)
    curve = straight + 0.02 * span * rng.standard_normal(straight.shape)
    ends = [kinematics.frame_placement(arm.expand_from_chart(z), arm.tip_id) for z in (curve[0], curve[-1])]
    t = np.linspace(0.0, 1.0, 101)[:, None]
    samples = sum(c * (1 - t) ** (3 - k) * t**k * curve[k] for k, c in enumerate((1, 3, 3, 1)))
    placed = [kinematics.frame_placement(arm.expand_from_chart(z), arm.tip_id) for z in samples]
    loose = StraightWay(arm.tip, *ends, 1.0, 3.0)
    worst = np.max([off(loose, one) for one in placed], axis=0)
    turns = World.build(arm, scene_of()).bodies.turns
    for factor, free in ((0.9, False), (1.3, True)):
        tolerances = factor * worst + 1e-6
        way = StraightWay(arm.tip, *ends, *tolerances.tolist())
        verdict = certify_straight(way, arm, turns, curve[None])
        assert verdict.free == free or (free and _beyond(way, placed))
        if not verdict.free:
            assert verdict.reason is Reason.PATH_CONSTRAINT


def _beyond(way: StraightWay, placed: list[pin.SE3]) -> bool:
    """Whether the frame is turned from the way's own direction beyond an end, where the oracle's share goes on."""
    return any(not 0.0 <= way.share(one) <= 1.0 for one in placed)


def test_turning_on_the_spot_may_take_its_time() -> None:
    """The last joint turns alone: the tip stays, and the pace of the turning is free."""
    arm = group("panda")
    kinematics, z = Kinematics(arm), arm.chart(arm.random(np.random.default_rng(3)))
    last = z.copy()
    last[-1] = z[-1] + 0.5
    ends = [kinematics.frame_placement(arm.expand_from_chart(one), arm.tip_id) for one in (z, last)]
    way = StraightWay(arm.tip, *ends, 1e-4, 1e-3)
    turns = World.build(arm, scene_of()).bodies.turns
    shares = np.array([0.0, 0.7, 0.8, 1.0])[:, None]
    assert certify_straight(way, arm, turns, (z + shares * (last - z))[None]).free
    aside = z + shares * (last - z)
    aside[1, 3] += 1e-2
    refused = certify_straight(way, arm, turns, aside[None])
    assert refused.reason is Reason.PATH_CONSTRAINT
    assert refused.parameter == pytest.approx(0.0, abs=0.6)
