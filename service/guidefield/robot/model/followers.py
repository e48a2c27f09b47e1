"""Mimic joints ("followers"), and Pinocchio models with joints replaced or locked.

A follower's value is ``multiplier * x + offset`` of the unwrapped value x of the joint at the end of its chain. A
continuous joint's configuration is the cosine and sine of its angle, in which whole turns are lost. That is right where
nothing follows it, or only continuous joints that turn by a whole multiple. A follower that turns by half as much, that
slides, or that has limits is elsewhere after a turn. Then the joint followed isn't periodic: it is loaded as a revolute
joint, whose configuration is its value.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.robot.model import chart
from guidefield.robot.model.model import Joint, Mimic, axis_of, joint_indices
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.robot.urdf.elements import UrdfFacts


def with_joints(model: Any, replacements: Mapping[int, Any]) -> Any:
    """Return the same Pinocchio model with joints replaced by index; the indices of joints and frames stay the same.

    Limits are kept where a joint has as many values as before; what replaces another has no limits of positions else.
    """
    if not replacements:
        return model
    made, _ = _rebuild(model, replacements, (), pin.neutral(model))
    return made


def lock_joints(model: Any, geometry: Any, locked: Collection[int], q: np.ndarray) -> tuple[Any, Any]:
    """Return the models with some joints, by index, fixed at a configuration, shape (model.nq,).

    Frames keep their indices and names; joints keep their order. `pinocchio.buildReducedModel` does the same, but finds
    frames by name.
    """
    if not locked:
        return model, geometry
    made, places = _rebuild(model, {}, locked, q)
    reduced = geometry.copy()
    for shape in reduced.geometryObjects:
        carrier, offset = places[shape.parentJoint]
        shape.parentJoint, shape.placement = carrier, offset * shape.placement
    return made, reduced


def _rebuild(
    model: Any, replacements: Mapping[int, Any], locked: Collection[int], q: np.ndarray
) -> tuple[Any, list[tuple[int, Any]]]:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    made = pin.Model()
    made.name = model.name
    kept: list[tuple[Any, Any]] = []
    places: list[tuple[int, Any]] = [(0, pin.SE3.Identity())]
    for index in range(1, model.njoints):
        carrier, offset = places[model.parents[index]]
        if index in locked:
            places.append((carrier, offset * data.liMi[index]))
        else:
            joint = replacements.get(index) or model.joints[index].extract()
            carrier = made.addJoint(carrier, joint, offset * model.jointPlacements[index], model.names[index])
            kept.append((model.joints[index], made.joints[carrier]))
            places.append((carrier, pin.SE3.Identity()))
        made.appendBodyToJoint(places[index][0], model.inertias[index], places[index][1])
    for number, frame in enumerate(list(model.frames)[1:]):
        carrier, offset = places[frame.parentJoint]
        # under a name of its own, as Pinocchio merges frames that share name and type
        copied = pin.Frame(f"frame {number}", carrier, frame.parentFrame, offset * frame.placement, frame.type)
        made.frames[made.addFrame(copied, False)].name = frame.name
    _copy_limits(model, made, kept)
    return made, places


def _copy_limits(source: Any, target: Any, kept: Sequence[tuple[Any, Any]]) -> None:
    for name, none in (("lowerPositionLimit", -math.inf), ("upperPositionLimit", math.inf)):
        limits = getattr(source, name)
        parts = [
            limits[joint.idx_q : joint.idx_q + joint.nq] if joint.nq == copied.nq else np.full(copied.nq, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))
    for name in ("lowerVelocityLimit", "upperVelocityLimit", "lowerEffortLimit", "upperEffortLimit"):
        limits, none = getattr(source, name), -math.inf if name == "lowerEffortLimit" else math.inf
        parts = [
            limits[joint.idx_v : joint.idx_v + joint.nv] if joint.nv == copied.nv else np.full(copied.nv, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))


def with_ball_joints(name: str, model: Any, marked: Collection[str]) -> Any:
    """Replace marked floating joints, which only turn, by spherical ones in a Pinocchio model; indices stay the same.

    RobotInvalid if a marked joint doesn't exist or isn't floating.
    """
    indices = joint_indices(model)
    for joint in marked:
        if joint not in indices:
            raise RobotInvalid(f"robot {name!r} has no joint {joint!r}, which its card marks as a ball", joint=joint)
        if model.joints[indices[joint]].shortname() != "JointModelFreeFlyer":
            raise RobotInvalid(f"robot {name!r}: joint {joint!r} is marked as a ball but isn't floating", joint=joint)
    return with_joints(model, {indices[joint]: pin.JointModelSpherical() for joint in marked})


def laws(facts: UrdfFacts) -> dict[str, Mimic]:
    """Return the law of each mimic joint of a URDF; its source is the joint at the end of its chain."""
    found = {}
    for follower in facts.mimics:
        driver, multiplier, offset = facts.mimics[follower]
        while driver in facts.mimics:
            driver, other, shift = facts.mimics[driver]
            multiplier, offset = multiplier * other, multiplier * shift + offset
        found[follower] = Mimic(driver, multiplier, offset)
    return found


def unwrapped(facts: UrdfFacts) -> dict[str, str]:
    """Return continuous joints whose whole turns count, each with a follower that is elsewhere after one.

    Such a joint is of kind revolute once it is loaded, without limits of its own.
    """
    found: dict[str, str] = {}
    for follower, law in laws(facts).items():
        returns = law.multiplier == 0.0 or (
            facts.joints[follower].kind == "continuous" and law.multiplier == np.round(law.multiplier)
        )
        if facts.joints[law.driver].kind == "continuous" and not returns:
            found.setdefault(law.driver, follower)
    return found


def with_unwrapped(model: Any, facts: UrdfFacts) -> Any:
    """Return the Pinocchio model of a URDF with the joints that `unwrapped` names as revolute ones, without limits."""
    indices = joint_indices(model)
    joints = {indices[name]: model.joints[indices[name]] for name in unwrapped(facts)}
    revolute = {index: pin.JointModelRevoluteUnaligned(axis_of(joint)) for index, joint in joints.items()}
    return with_joints(model, revolute)


def follow(joints: Sequence[Joint], q: RobotConfiguration) -> None:
    """Set, in place, the mimic joints in a configuration (nq,), by the source joints, which must be among `joints`."""
    followers = [(joint, joint.mimic) for joint in joints if joint.mimic is not None]
    by_name = {joint.name: joint for joint in joints} if followers else {}
    for joint, mimic in followers:
        driver = by_name[mimic.driver]
        if driver.nq == joint.nq == 1:  # the chart is the value itself, which most followers have
            q[joint.idx_q] = mimic.multiplier * q[driver.idx_q] + mimic.offset
            continue
        values = [q[one.idx_q : one.idx_q + one.nq] for one in (driver, joint)]
        z = mimic.multiplier * chart.to_chart(driver, values[0], values[0]) + mimic.offset
        q[joint.idx_q : joint.idx_q + joint.nq] = chart.from_chart(joint, z, values[1])


def expansion(joints: Sequence[Joint], model: Any, space: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the affine map from the chart of planned joints to that of a model with their followers.

    A matrix, shape (model.nv, space.nv), and an offset, shape (model.nv,); `space` is the model of planned joints
    alone.
    """
    by_name, planned = {joint.name: joint for joint in joints}, joint_indices(space)
    matrix, offset = np.zeros((model.nv, space.nv)), np.zeros(model.nv)
    for index in range(1, model.njoints):
        joint, row = by_name[model.names[index]], model.joints[index].idx_v
        law = joint.mimic or Mimic(joint.name, 1.0, 0.0)
        column = space.joints[planned[law.driver]].idx_v
        matrix[row : row + joint.nv, column : column + joint.nv] = law.multiplier * np.eye(joint.nv)
        offset[row] = law.offset
    return matrix, offset
