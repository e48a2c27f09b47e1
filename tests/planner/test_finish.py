"""What the certificate refuses is repaired: optimised again, with samples that see what was overlooked."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner import finish as module, optimized_motion
from guidefield.planner.finish import REPAIRS, STOPPING, certify_found_path, finish
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.optimization import Optimized, optimize
from guidefield.planner.optimize.passages import REACHED
from guidefield.planner.optimize.settings import (
    BALANCED,
    OptimizationSettings,
    closer,
    free,
    in_few_pieces,
)
from guidefield.planner.optimized_motion import LOOKS
from guidefield.planner.path_so_far import PathSoFar, time_path_ignoring_jerk
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages, make_refusal
from guidefield.prove.certificate import certify
from guidefield.prove.verdict import Reason
from guidefield.scene.guide_plane import build
from tests.planner.walls import over_the_wall, smallest_clearance


def through_the_wall(made: Problem, path: np.ndarray) -> Trajectory:
    """The straight motion, which touches the wall."""
    return time_path_ignoring_jerk(made, path[[0, -1]])


def misled(monkeypatch: pytest.MonkeyPatch, trajectories: Sequence[Trajectory]) -> list[OptimizationSettings]:
    """Has optimisations give trajectories that touch, the first so many; how each was asked for."""
    asked: list[OptimizationSettings] = []

    def mislead(problem: Problem, motion: Trajectory, settings: OptimizationSettings, *_: Any, **__: Any) -> Optimized:
        asked.append(settings)
        optimized = optimize(problem, motion, settings)
        if len(asked) <= len(trajectories):
            return dataclasses.replace(optimized, trajectory=trajectories[len(asked) - 1])
        return optimized

    monkeypatch.setattr(optimized_motion, "optimize", mislead)
    return asked


def test_a_refused_motion_is_optimised_again_looking_closer(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    asked = misled(monkeypatch, [through_the_wall(made, path)])
    stages = Stages(made)
    finished = finish(made, PathSoFar(path, proven=False), stages)
    begun = in_few_pieces(free(BALANCED))
    assert asked == [begun, closer(begun)]
    assert finished.verdict.free
    assert finished.warnings == ()
    assert certify(made.world, finished.trajectory.bezier()).free
    assert smallest_clearance(made, finished.path, 0.3) > 0.03
    assert [stage.outcome for stage in stages.left if stage.name == "certify"] == ["contact", "free"]


def test_a_motion_that_nothing_repairs_is_the_one_that_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    misled(monkeypatch, 2 * (2 + LOOKS) * [through_the_wall(made, path)])
    finished = finish(made, PathSoFar(path), Stages(made))
    assert finished.verdict.free
    np.testing.assert_array_equal(finished.path[[0, -1]], path[[0, -1]])
    assert "the optimised motion was not certified (contact)" in finished.warnings[0]
    assert "as it was found" in finished.warnings[0]
    assert not finish(made, PathSoFar(path, proven=False), Stages(made)).verdict.free


def guided_over_the_wall() -> tuple[Problem, np.ndarray, dict[int, int]]:
    """The same with a plane at the path's middle."""
    made, path = over_the_wall()
    middle = len(path) // 2
    tip = made.kinematics.tip_position(made.group.expand_from_chart(path[middle]))
    corners = [tip + 0.1 * np.array([a, 0.0, b]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    plane = build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)
    return dataclasses.replace(made, guide_planes=(plane,)), path, {0: middle}


def test_an_optimised_guided_motion_crosses_its_plane_where_its_knot_says() -> None:
    made, path, crossings = guided_over_the_wall()
    finished = finish(made, PathSoFar(path, crossings, proven=False), Stages(made))
    assert finished.verdict.free
    assert finished.warnings == ()
    tip = made.kinematics.tip_position(made.group.expand_from_chart(finished.path[finished.crossings[0]]))
    assert abs(made.guide_planes[0].signed_height(tip)) <= REACHED
    assert made.guide_planes[0].contains(tip)
    assert (
        finished.trajectory.duration
        < certify_found_path(made, PathSoFar(path, crossings), Stages(made)).trajectory.duration
    )


def test_what_is_refused_round_corners_is_drawn_closer_and_stops_at_them_in_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, path, crossings = guided_over_the_wall()
    asked, closeness = dataclasses.replace(made, optimization_iterations=0), list[int]()

    def refused(*asked_for: Any) -> tuple[Trajectory, dict[int, int]]:
        closeness.append(asked_for[-1])
        return through_the_wall(made, path), {}

    monkeypatch.setattr(module, "_round_corners", refused)
    finished = finish(asked, PathSoFar(path, crossings), Stages(asked))
    assert closeness == [2**k for k in range(REPAIRS + 1)]
    assert finished.verdict.free
    assert finished.warnings == (STOPPING,)
    for waypoint in path:
        (knots,) = np.nonzero((finished.path == waypoint).all(axis=1))
        assert not finished.trajectory.velocities[knots].any()
    np.testing.assert_array_equal(finished.path[finished.crossings[0]], path[crossings[0]])


def test_an_end_beyond_a_limit_is_refused_by_joint_value_limits_and_place() -> None:
    made, path = over_the_wall()
    joint, upper = made.group.joints[0], float(made.group.upper[0])
    beyond = path.copy()
    beyond[0, 0] = upper + 0.01
    stages = Stages(made)
    refused = finish(made, PathSoFar(beyond, proven=False), stages).verdict
    # a motion that is drawn closer to a path that is beyond a limit would be, too: it is not tried
    assert [stage.outcome for stage in stages.left if stage.name == "certify"] == ["beyond limits"] * 2
    assert (refused.reason, refused.piece) == (Reason.BEYOND_LIMITS, 0)
    ending = make_refusal(made, refused)
    details = ending.details
    assert ending.status is Status.INVALID_MOTION_PLAN
    assert f"joint {joint.name} reaches {upper + 0.01:.6g}, 0.01 beyond its limits" in ending.message
    assert (details["joint"], details["limits"]) == (joint.name, [made.group.lower[0], upper])
    assert details["value"] == pytest.approx(upper + 0.01)
    assert details["excess"] == pytest.approx(0.01)
    assert details["configuration"][joint.name] == pytest.approx(upper + 0.01)
