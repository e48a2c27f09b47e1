"""Constraints of an MJCF beside its joints: which of them a URDF's <mimic> can say, and sentences about the others."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from guidefield.robot.mjcf.compilation import import_mujoco
from guidefield.robot.mjcf.names import joint_names, named


@dataclass(frozen=True)
class JointLaws:
    """Equality constraints of joints with one value.

    Attributes:
        mimics: By joint: its source joint, multiplier and offset.
        constants: By joint: the one value that it is held at.
    """

    mimics: dict[int, tuple[int, float, float]] = field(default_factory=dict)
    constants: dict[int, float] = field(default_factory=dict)


def joint_laws(model: Any, warnings: list[str]) -> JointLaws:
    """Read the linear equalities of joints, y - y0 = a0 + a1 (x - x0); y0 and x0 are the joints' reference values.

    Args:
        model: `mujoco.MjModel`.
        warnings: Gets a sentence for each active constraint that isn't kept: those of bodies, sites, tendons and
            flexes, of joints by a curve, and a second one of the same joint, or one that would close a circle.
    """
    mujoco = import_mujoco()
    laws, joints = JointLaws(), joint_names(model)
    reference = [float(model.qpos0[address]) for address in model.jnt_qposadr]
    names = named(model, "equality")
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        what = f"<equality> {kind}" + (f" {names[index]!r}" if names[index] else "")
        if kind != "joint":
            warnings.append(f"{what} isn't kept: what it closes or couples moves by itself")
            continue
        follower, source = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        offset, slope, *curve = (float(number) for number in model.eq_data[index, :5])
        told = f"{what} of joint {joints[follower]!r}"
        if follower in laws.mimics or follower in laws.constants:
            warnings.append(f"{told} isn't kept: the joint has another one")
        elif source < 0 or (slope == 0.0 and not any(curve)):
            laws.constants[follower] = reference[follower] + offset
        elif any(curve):
            warnings.append(f"{told} isn't kept: it follows {joints[source]!r} by a curve, and moves by itself here")
        elif _follows(laws, source, follower):
            warnings.append(f"{told} isn't kept: {joints[source]!r} follows it already")
        else:
            shift = reference[follower] + offset - slope * reference[source]
            laws.mimics[follower] = (source, slope, shift)
    return laws


def _follows(laws: JointLaws, joint: int, source: int) -> bool:
    """Return True if a joint is another one, or follows it."""
    while joint != source and joint in laws.mimics:
        joint = laws.mimics[joint][0]
    return joint == source


def tendon_warnings(model: Any) -> list[str]:
    """A sentence about the tendons, if there are any: what they couple or limit moves by itself here."""
    if not model.ntendon:
        return []
    names = [name or f"number {index}" for index, name in enumerate(named(model, "tendon"))]
    limited = int(model.tendon_limited.sum())
    limits = f", nor the length limits of {limited} of them" if limited else ""
    some = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return [f"what tendons couple isn't kept{limits}: {some}"]
