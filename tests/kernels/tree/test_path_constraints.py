"""Path constraints in kernels: their numbers are Pinocchio's, and Newton's way back is that by Pinocchio's rows."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.tree.path_constraints import bring_back, largest_share
from guidefield.robot.group import path_constraints
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames, EvenTurn, keep_frames, line, plane
from tests.robots import ARMS, box_arm, group, grouped

ROOM, CORRECTIONS = 0.6, 15

ROBOTS = (*ARMS, "continuous y oblique-continuous mimic", "slide oblique screw x")


def random_frames(name: str, rng: np.random.Generator) -> ConstrainedFrames:
    """Two cones, a plane, a line, an even turn and a point, about the tip and about the first joint."""
    arm = group(name) if name in ARMS else grouped(box_arm(name, 4))
    axes = rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    first, point = arm.model.names[1], rng.uniform(-0.5, 0.5, 3)
    cone, low = Cone(arm.tip, axes[0], axes[1], 0.4), Cone(first, axes[3], axes[4], 0.5)
    flat, straight = plane(arm.tip, point, axes[2], 0.02), line(arm.tip, point, axes[2], 0.05)
    near = path_constraints.point(arm.tip, rng.uniform(-0.5, 0.5, 3), 0.1)
    even = EvenTurn(arm.tip, pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)), *rng.normal(size=(2, 3)), 0.3)
    return ConstrainedFrames(arm, (cone, low, flat, straight, even, near))


def brought_back(frames: ConstrainedFrames, z: np.ndarray) -> np.ndarray | None:
    """The same by Pinocchio and a general solver."""
    aim, lower, upper = ROOM * frames.limits, frames.group.lower, frames.group.upper
    for _ in range(CORRECTIONS):
        values, rows = frames.values_and_rows(z)
        excess = values - aim
        if (excess <= 1e-6 * aim).all():
            return z
        A = rows[excess > 0.0]
        z = np.clip(z - A.T @ np.linalg.solve(A @ A.T + 1e-12 * np.eye(len(A)), excess[excess > 0.0]), lower, upper)
    return None


@pytest.mark.parametrize("name", ROBOTS)
def test_the_numbers_are_those_of_pinocchio(name: str) -> None:
    rng = np.random.default_rng(0)
    frames = random_frames(name, rng)
    for _ in range(20):
        z = frames.group.to_local(frames.group.random(rng))
        expected = (frames.values(z) / frames.limits).max()
        assert largest_share(keep_frames(frames), z) == pytest.approx(expected, abs=1e-10)


def test_it_comes_back_where_pinocchio_does() -> None:
    rng, came = np.random.default_rng(2), 0
    for _ in range(40):
        whole = random_frames("panda", rng)
        frames = ConstrainedFrames(whole.group, whole.constraints[:1] + whole.constraints[2:3])
        z = frames.group.to_local(frames.group.random(rng))
        expected, found = brought_back(frames, z), z.copy()
        there = bring_back(keep_frames(frames), ROOM, CORRECTIONS, found)
        assert there == (expected is not None)
        if expected is not None:
            came += 1
            np.testing.assert_allclose(found, expected, atol=1e-6)
            assert (frames.values(found) <= ROOM * frames.limits * (1.0 + 1e-5)).all()
    assert came >= 10
