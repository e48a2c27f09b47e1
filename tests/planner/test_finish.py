"""What the certificate refuses is repaired: relaxed again with samples that see what was overlooked."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.verdict import Reason
from guidefield.errors import Status
from guidefield.planner import finish as module
from guidefield.planner.finish import HURRIED, finish
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.relax.relaxation import Outcome, Relaxed, relax
from guidefield.planner.relax.settings import RELAXATION
from guidefield.planner.task.refusal import refusal
from guidefield.planner.task.stages import Stages
from tests.planner.relax.test_relaxation import over_the_wall, smallest_clearance


def lowered_into_contact(path: np.ndarray) -> np.ndarray:
    """A path over the wall with its middle bent down until it touches."""
    made, _ = over_the_wall()
    bad, middle = path.copy(), len(path) // 2
    while smallest_clearance(made, bad) > -0.015:
        bad[middle - 3 : middle + 4, 3] -= 0.01
    return bad


def test_a_refused_motion_is_relaxed_again_looking_closer(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    asked: list[float] = []

    def misled(*arguments: Any, segment: float = RELAXATION.segment) -> Relaxed:
        relaxed = relax(*arguments, segment=segment)
        asked.append(segment)
        first = len(asked) == 1
        return dataclasses.replace(relaxed, path=lowered_into_contact(relaxed.path)) if first else relaxed

    monkeypatch.setattr(module, "relax", misled)
    stages = Stages(made)
    finished = finish(made, PathSoFar(path, proven=False), stages)
    assert asked == [RELAXATION.segment, RELAXATION.finer * RELAXATION.segment]
    assert finished.verdict.free
    assert finished.warnings == ()
    assert certify(made.world, finished.trajectory.bezier()).free
    assert smallest_clearance(made, finished.path, 0.3) > 0.03
    outcomes = [stage.outcome for stage in stages.left if stage.name == "certify"]
    # a spline drawn closer to a path that touches would touch, too: it is not tried
    assert outcomes == ["contact", "free"]


def test_a_repaired_motion_whose_relaxation_had_no_time_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    asked: list[float] = []

    def misled(*arguments: Any, segment: float = RELAXATION.segment) -> Relaxed:
        relaxed = relax(*arguments, segment=segment)
        asked.append(segment)
        if len(asked) == 1:
            return dataclasses.replace(relaxed, path=lowered_into_contact(relaxed.path))
        return dataclasses.replace(relaxed, outcome=Outcome.OUT_OF_TIME)

    monkeypatch.setattr(module, "relax", misled)
    finished = finish(made, PathSoFar(path, proven=False), Stages(made))
    assert finished.verdict.free
    assert finished.warnings == (HURRIED,)


def test_a_motion_that_nothing_repairs_is_the_one_that_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()

    def misled(*arguments: Any, segment: float = RELAXATION.segment) -> Relaxed:
        relaxed = relax(*arguments, segment=segment)
        return dataclasses.replace(relaxed, path=lowered_into_contact(relaxed.path))

    monkeypatch.setattr(module, "relax", misled)
    finished = finish(made, PathSoFar(path), Stages(made))
    assert finished.verdict.free
    np.testing.assert_array_equal(finished.path[[0, -1]], path[[0, -1]])
    assert "as it was found" in finished.warnings[0]
    assert not finish(made, PathSoFar(path, proven=False), Stages(made)).verdict.free


def test_shorter_segments_are_more() -> None:
    made, path = over_the_wall()
    assert len(relax(made, path, {}, segment=RELAXATION.finer * RELAXATION.segment).path) > 1.5 * len(
        relax(made, path, {}).path
    )


def test_a_spline_keeps_limits_that_a_waypoint_is_beyond(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    upper = float(made.group.upper[0])

    def misled(*arguments: Any, segment: float = RELAXATION.segment) -> Relaxed:
        relaxed = relax(*arguments, segment=segment)
        beyond = relaxed.path.copy()
        beyond[len(beyond) // 2, 0] = upper + 0.01
        return dataclasses.replace(relaxed, path=beyond)

    monkeypatch.setattr(module, "relax", misled)
    finished = finish(made, PathSoFar(path), Stages(made))
    assert finished.verdict.free
    assert finished.trajectory.bezier()[:, :, 0].max() <= upper + 1e-12


def test_an_end_beyond_a_limit_is_refused_by_joint_value_limits_and_place() -> None:
    made, path = over_the_wall()
    joint, upper = made.group.joints[0], float(made.group.upper[0])
    beyond = path.copy()
    beyond[0, 0] = upper + 0.01
    stages = Stages(made)
    refused = finish(made, PathSoFar(beyond, proven=False), stages).verdict
    # a spline that is drawn closer to a path that is beyond a limit would be, too: it is not tried
    assert [stage.outcome for stage in stages.left if stage.name == "certify"] == ["beyond limits"] * 2
    assert (refused.reason, refused.piece) == (Reason.BEYOND_LIMITS, 0)
    ending = refusal(made, refused)
    details = ending.details
    assert ending.status is Status.INVALID_MOTION_PLAN
    assert f"joint {joint.name} reaches {upper + 0.01:.6g}, 0.01 beyond its limits" in ending.message
    assert (details["joint"], details["limits"]) == (joint.name, [made.group.lower[0], upper])
    assert details["value"] == pytest.approx(upper + 0.01)
    assert details["excess"] == pytest.approx(0.01)
    assert details["configuration"][joint.name] == pytest.approx(upper + 0.01)
