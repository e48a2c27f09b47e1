"""Contacts are found whatever was asked before."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from guidefield.robot.model.pairs import scratch_space


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
