"""Robots for the fixed requests, each with a kind of joint that the catalog's arms don't have."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

_LINK = '<link name="{0}"><collision><origin xyz="{1}"/><geometry>{2}</geometry></collision></link>'
_JOINT = (
    '<joint name="{0}" type="{1}"><origin xyz="{2}"/><parent link="{3}"/><child link="{4}"/>'
    '<axis xyz="{5}"/>{6}</joint>'
)


def _limit(lower: float, upper: float, velocity: float) -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="{velocity}"/>'


def _robot(links: Iterable[tuple[str, ...]], joints: Iterable[tuple[str, ...]], root: str = "fixed") -> dict[str, Any]:
    parts = [*(_LINK.format(*link) for link in links), *(_JOINT.format(*joint) for joint in joints)]
    return {"type": "urdf", "text": f'<robot name="fixed">{"".join(parts)}</robot>', "root_joint": root}


LIFT = _robot(
    [
        ("base", "0 0 0.1", '<cylinder radius="0.1" length="0.2"/>'),
        ("carriage", "0 0 0", '<box size="0.1 0.1 0.1"/>'),
        ("upper", "0.15 0 0", '<box size="0.26 0.06 0.06"/>'),
        ("fore", "0.12 0 0", '<box size="0.2 0.05 0.05"/>'),
        ("hand", "0.04 0 0", '<sphere radius="0.03"/>'),
        ("left", "0.03 0 0", '<box size="0.06 0.01 0.02"/>'),
        ("right", "0.03 0 0", '<box size="0.06 0.01 0.02"/>'),
    ],
    [
        ("lift", "prismatic", "0 0 0.35", "base", "carriage", "0 0 1", _limit(0.0, 0.5, 0.5)),
        ("shoulder", "continuous", "0 0 0.1", "carriage", "upper", "0 0 1", ""),
        ("elbow", "revolute", "0.3 0 0", "upper", "fore", "0 0 1", _limit(-2.5, 2.5, 1.5)),
        ("wrist", "revolute", "0.25 0 0", "fore", "hand", "0 1 0", _limit(-1.5, 1.5, 2.0)),
        ("grip", "prismatic", "0.08 0.02 0", "hand", "left", "0 1 0", _limit(0.0, 0.03, 0.1)),
        (
            *("follow", "prismatic", "0.08 -0.02 0", "hand", "right", "0 -1 0"),
            _limit(0.0, 0.03, 0.1) + '<mimic joint="grip" multiplier="1" offset="0"/>',
        ),
    ],
)
"""Prismatic, continuous and revolute joints, and a finger that follows another."""

_FOOT = ("foot", "0 0 0.1", '<box size="0.2 0.2 0.2"/>')
_TURN = ("turn", "revolute", "0.1 0 0.3", "foot", "hand", "0 0 1", _limit(-1.0, 1.0, 1.0))

WHEELED = _robot([_FOOT, ("hand", "0.2 0 0", '<box size="0.3 0.05 0.05"/>')], [_TURN], "planar")
"""A foot that slides and turns on the ground, with one joint."""

FLOATER = _robot(
    [("body", "0 0 0", '<sphere radius="0.12"/>'), ("tail", "0.2 0 0", '<box size="0.2 0.04 0.04"/>')],
    [("swing", "revolute", "0.1 0 0", "body", "tail", "0 1 0", _limit(-1.2, 1.2, 1.0))],
    "free",
)
"""A body that flies, with a tail."""

FOLLOWERS = _robot(
    [(f"l{i}", "0 0 0.1", '<box size="0.05 0.05 0.18"/>') for i in range(5)],
    [
        ("j1", "revolute", "0 0 0.22", "l0", "l1", "0 1 0", _limit(-2.0, 2.0, 1.0)),
        (
            *("j2", "revolute", "0 0 0.22", "l1", "l2", "0 1 0"),
            _limit(-2.0, 2.0, 1.0) + '<mimic joint="j1" multiplier="-0.5" offset="0.2"/>',
        ),
        ("j3", "continuous", "0 0 0.22", "l2", "l3", "1 2 -0.5", ""),
        ("j4", "continuous", "0 0 0.22", "l3", "l4", "0 1 0", '<mimic joint="j3" multiplier="0.5" offset="0"/>'),
    ],
)
"""A revolute joint that follows another against its sense, and a continuous one that follows at half the pace."""
