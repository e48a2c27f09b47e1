"""Continuous validation by HPP of the motions in a referee's file, run by the Python of HPP's own environment.

Usage: python hpp_validation.py FILE

Prints a line of JSON for each case, as `hpp.Heard` has it. The robot goes to HPP as a URDF of the referee's model, its
bodies as Coal's shapes, and each piece of the motion as a cubic of which the control points are set.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from pyhpp.core import Problem, Progressive, SplineBezier3
from pyhpp.pinocchio import Device, urdf

sys.path.append(str(Path(__file__).resolve().parents[2] / "service"))
from guidefield.referee.case import Case
from guidefield.referee.loading import load

CLOSER = 2e-6
"""Bodies that touch are deeper in one another than this, or meshes, of which Coal tells no depth; others graze [m]."""
TOLERANCES = 1e-5, 3e-5, 1e-4, 3e-4
"""HPP goes on so far where bodies nearly touch [m]: the next where the contact that it comes to only grazes."""


class Validation:
    """One case as HPP has it, which judges neither limits nor clearances.

    Args:
        case: What the referee judges; each of its joints has one freedom.
    """

    def __init__(self, case: Case) -> None:
        self._case, self._robot = case, Device("robot")
        pairs = set(_pairs(case))
        self._pieces = list(_pieces(case))
        text = _urdf(case, np.concatenate([points for *_, points in self._pieces]))
        urdf.loadModelFromString(self._robot, 0, "", "anchor", text, _srdf(case, pairs), pin.SE3.Identity())
        self._geometry, self._model = self._robot.geomModel(), self._robot.model()
        for pair, both in zip(self._geometry.collisionPairs, self._bodies(), strict=True):
            for shape, body in zip((pair.first, pair.second), both, strict=True):
                self._geometry.geometryObjects[shape].geometry = case.bodies[body].exact
        if {(min(both), max(both)) for both in self._bodies()} != pairs:
            raise RuntimeError("HPP judges other pairs")
        rows = [self._model.joints[self._model.getJointId(f"joint{i}")].idx_v for i in range(1, case.model.njoints)]
        self._order = np.argsort(rows)
        self._problem = Problem(self._robot)

    def heard(self) -> dict[str, Any]:
        """The first contact along the motion, or that there is none."""
        found = self._first(TOLERANCES[0])
        for tolerance in TOLERANCES[1:]:
            if found["answer"] != "grazes" or (deeper := self._first(tolerance))["answer"] == "free":
                break
            found = deeper
        return found

    def _first(self, tolerance: float) -> dict[str, Any]:
        validation = Progressive(self._robot, tolerance)
        for start, h, points in self._pieces:
            path = self._cubic(points[:, self._order])
            valid, _, report = validation.validate(path, False)
            if not valid:
                share = report.parameter / path.length()
                return self._touching(path.eval(report.parameter)[0]) | {"at": start + share * h}
        return {"answer": "free"}

    def _cubic(self, points: np.ndarray) -> Any:
        """HPP's cubic with control points (4, nv), in its order."""
        ends = (pin.integrate(self._model, pin.neutral(self._model), y) for y in (points[0], points[0] + 1.0))
        path = SplineBezier3(self._problem).steer(*ends)
        path.parameterIntegrate((points - points[0]).ravel() - path.rowParameters())
        middle = pin.integrate(self._model, pin.neutral(self._model), points.T @ [0.125, 0.375, 0.375, 0.125])
        if not np.allclose(path.eval(0.5 * path.length())[0], middle, rtol=0.0, atol=1e-9):
            raise RuntimeError("HPP's cubic is another one")
        return path

    def _touching(self, q: np.ndarray) -> dict[str, Any]:
        """The pair that touches where HPP says that one does, by Coal."""
        scratch, request = self._geometry.createData(), coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 100)
        pin.updateGeometryPlacements(self._model, self._model.createData(), self._geometry, scratch, q)
        stand = [coal.Transform3s(placed.rotation, placed.translation) for placed in scratch.oMg]
        for pair, both in zip(self._geometry.collisionPairs, self._bodies(), strict=True):
            a, b = (self._case.bodies[k] for k in both)
            result = coal.CollisionResult()
            coal.collide(a.exact, stand[pair.first], b.exact, stand[pair.second], request, result)
            meshes = isinstance(a.exact, coal.BVHModelBase) or isinstance(b.exact, coal.BVHModelBase)
            if any(meshes or one.penetration_depth < -CLOSER for one in result.getContacts()):
                return {"answer": "contact", "pair": [a.name, b.name]}
        return {"answer": "grazes"}

    def _bodies(self) -> list[tuple[int, int]]:
        """The numbers of the two bodies of each pair, in HPP's order."""
        number = [int(shape.name.removeprefix("body").rpartition("_")[0]) for shape in self._geometry.geometryObjects]
        return [(number[pair.first], number[pair.second]) for pair in self._geometry.collisionPairs]


def _pieces(case: Case) -> Iterator[tuple[float, float, np.ndarray]]:
    """Start and duration of each cubic [s], and its control points as values of all joints (4, nv)."""
    times = np.arange(float(len(case.positions))) if case.times is None else case.times
    for k, h in enumerate(np.diff(times).tolist()):
        p, q = case.positions[k : k + 2]
        v, w = ((q - p) / h,) * 2 if case.velocities is None else case.velocities[k : k + 2]
        z = np.array([p, p + h / 3.0 * v, q - h / 3.0 * w, q])
        yield float(times[k]), h, z @ case.spread.T + case.offset


def _urdf(case: Case, points: np.ndarray) -> str:
    """A robot that moves as the case's model does; its bodies and obstacles are balls until they are replaced.

    Its limits are about the control points (k, nv): HPP bounds what a slide moves by them.
    """
    model, lower, upper = case.model, points.min(axis=0).tolist(), points.max(axis=0).tolist()
    told = [f'<link name="link{i}"/>' for i in range(model.njoints)]
    for i in range(1, model.njoints):
        joint = model.joints[i].createData()
        model.joints[i].calc(joint, pin.neutral(model)[model.joints[i].idx_q :][: model.joints[i].nq])
        slide, turn = np.split(np.array(joint.S).reshape(6), 2)
        kind = "prismatic" if slide.any() else "continuous" if model.joints[i].nq == 2 else "revolute"
        told.append(
            _joint(f"joint{i}", kind, f"link{model.parents[i]}", f"link{i}", model.jointPlacements[i])
            + f'<axis xyz="{_words(slide + turn)}"/>'
            + f'<limit lower="{lower[i - 1]!r}" upper="{upper[i - 1]!r}" effort="1" velocity="1"/></joint>'
        )
    for k, body in enumerate(case.bodies):
        told.append(f'<link name="body{k}"><collision><geometry><sphere radius="1"/></geometry></collision></link>')
        told.append(_joint(f"at{k}", "fixed", f"link{body.joint}", f"body{k}", body.placement) + "</joint>")
    return f'<robot name="robot">{"".join(told)}</robot>'


def _joint(name: str, kind: str, parent: str, child: str, placement: Any) -> str:
    xyz, rpy = _words(placement.translation), _words(pin.rpy.matrixToRpy(placement.rotation))
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
        f'<child link="{child}"/>'
    )


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _srdf(case: Case, pairs: set[tuple[int, int]]) -> str:
    """All pairs that aren't judged are left out."""
    told = [
        f'<disable_collisions link1="body{i}" link2="body{j}" reason="Never"/>'
        for i, j in itertools.combinations(range(len(case.bodies)), 2)
        if (i, j) not in pairs
    ]
    return f'<robot name="robot">{"".join(told)}</robot>'


def _pairs(case: Case) -> Iterator[tuple[int, int]]:
    """Pairs of bodies that move relative to one another and aren't left out."""
    planned = {i for i, joint in enumerate(case.model.joints) if i and case.spread[joint.idx_v].any()}
    moved = [planned & set(case.model.supports[body.joint]) for body in case.bodies]
    left_out = {frozenset(pair[:2]) for pair in case.left_out}
    for (i, a), (j, b) in itertools.combinations(enumerate(case.bodies), 2):
        if moved[i] != moved[j] and frozenset((a.name, b.name)) not in left_out:
            yield i, j


def _unknown(case: Case) -> str:
    """Why HPP can't judge a case; nothing where it can."""
    if any(joint.nv != 1 for joint in list(case.model.joints)[1:]):
        return "a joint has several freedoms"
    return "an obstacle moves" if any(body.screw is not None for body in case.bodies) else ""


def _judged(case: Case) -> dict[str, Any]:
    if reason := _unknown(case):
        return {"answer": "not judged", "reason": reason}
    validation, began = Validation(case), time.process_time()
    return validation.heard() | {"seconds": time.process_time() - began}


if __name__ == "__main__":
    for one in load(Path(sys.argv[1])):
        print(json.dumps(_judged(one)), flush=True)
