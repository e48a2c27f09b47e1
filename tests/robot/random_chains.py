"""Random robots: 1 to 20 joints of every kind, branches, and joints that follow others."""

import random
from dataclasses import dataclass

from hypothesis import strategies as st

from guidefield.messages.requests import UrdfText

KINDS = ("revolute", "revolute", "continuous", "prismatic", "fixed", "planar", "floating", "mimic")
"""Kinds of joints, `mimic` for one that follows another: it turns within limits, slides, or turns on and on."""
WOUND = ("continuous", "continuous", "revolute", "prismatic", "mimic", "mimic", "mimic")
"""Kinds of joints of which many are angles whose whole turns count."""

MULTIPLIERS = (0.5, 1.5, -0.5, 2.0, -1.0)
"""Turns of a mimic joint per turn of its source joint, beside any number: halves, and whole ones, which return."""

PITCH = 0.05  # a sliding mimic joint's share of a turning one's multiplier [m/rad]

_AXES = ("1 0 0", "0 1 0", "0 0 1", "1 2 -0.5", "-0.3 0.1 0.9")
_TURNS = ("0 0 0", "1.5708 0 0", "0 0.7 -0.2", "0.1 -1.2 3.1")
_SHAPES = (
    '<box size="{w} {w} {h}"/>',
    '<cylinder radius="{r}" length="{h}"/>',
    '<sphere radius="{r}"/>',
    '<capsule radius="{r}" length="{h}"/>',
)


@dataclass(frozen=True)
class RandomJoint:
    """A joint, and the link that it moves."""

    kind: str
    parent: int
    axis: str
    turn: str
    shape: str
    length: float
    lower: float
    upper: float
    multiplier: float
    offset: float


def chains(most: int = 20, kinds: tuple[str, ...] = KINDS) -> st.SearchStrategy[UrdfText]:
    """Random robots of at most so many joints."""
    return st.builds(chain, st.randoms(use_true_random=False), st.integers(1, most), st.just(kinds))


def chain(rng: random.Random, count: int, kinds: tuple[str, ...] = KINDS) -> UrdfText:
    """A random robot of so many joints; its joints are j1, j2, …, its links l0, l1, …"""
    joints: list[RandomJoint] = []
    for index in range(count):
        kind = rng.choice(kinds)
        driven = any(joint.kind in ("revolute", "continuous", "prismatic", "mimic") for joint in joints)
        joints.append(
            RandomJoint(
                kind="revolute" if kind == "mimic" and not driven else kind,
                parent=rng.randint(max(0, index - 2), index),
                axis=rng.choice(_AXES),
                turn=rng.choice(_TURNS),
                shape=rng.choice(_SHAPES),
                length=round(rng.uniform(0.05, 0.3), 3),
                lower=round(rng.uniform(-3.0, -0.2), 3),
                upper=round(rng.uniform(0.2, 3.0), 3),
                multiplier=rng.choice((round(rng.uniform(-1.5, 1.5), 3), *MULTIPLIERS)),
                offset=round(rng.uniform(-0.2, 0.2), 3),
            )
        )
    parts = [_link(0, joints[0])]
    for index, joint in enumerate(joints, 1):
        parts += [_link(index, joint), _joint(index, joint, joints[: index - 1])]
    return UrdfText(text=f'<robot name="random" version="1.1">{"".join(parts)}</robot>')


def _link(index: int, joint: RandomJoint) -> str:
    height = round(0.8 * joint.length, 4)
    shape = joint.shape.format(w=0.03, r=0.015, h=height)
    return (
        f'<link name="l{index}"><collision><origin xyz="0 0 {joint.length / 2:.4f}"/>'
        f"<geometry>{shape}</geometry></collision></link>"
    )


def _joint(index: int, joint: RandomJoint, before: list[RandomJoint]) -> str:
    kind, mimic = joint.kind, ""
    if kind == "mimic":
        sources = [k for k, other in enumerate(before, 1) if other.kind not in ("fixed", "planar", "floating")]
        turning = [k for k in sources if before[k - 1].kind == "continuous"]
        sources = turning if turning and index % 2 else sources
        kind = ("revolute", "prismatic", "continuous", "continuous", "prismatic")[index % 5]
        source = sources[index % len(sources)]
        multiplier = round(PITCH * joint.multiplier, 5) if kind == "prismatic" else joint.multiplier
        mimic = f'<mimic joint="j{source}" multiplier="{multiplier}" offset="{joint.offset}"/>'
    scale = 0.1 if kind == "prismatic" else 1.0
    above = before[joint.parent - 1].length if joint.parent else joint.length
    return (
        f'<joint name="j{index}" type="{kind}"><origin xyz="0 0 {above:.4f}" rpy="{joint.turn}"/>'
        f'<parent link="l{joint.parent}"/><child link="l{index}"/><axis xyz="{joint.axis}"/>'
        f'<limit lower="{scale * joint.lower:.4f}" upper="{scale * joint.upper:.4f}" effort="1" velocity="2"/>'
        f"{mimic}</joint>"
    )
