"""Robots for the tests: some of the catalog, loaded once, and small ones written here."""

import functools

import numpy as np
import pinocchio as pin

from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import RobotModel

ARMS = ("panda", "ur5", "xarm7", "kinova")

_CATALOG = Catalog()


@functools.cache
def robot(name: str) -> RobotModel:
    """A robot of the catalog."""
    return _CATALOG.load(name)


@functools.cache
def group(name: str) -> PlanningGroup:
    """A robot's default group, its base at the world's origin."""
    model = robot(name)
    return select(model, None, None, model.rest, pin.SE3.Identity())


def rest(planned: PlanningGroup) -> np.ndarray:
    """The rest configuration of a group, shape (nq,)."""
    return planned.part_of(planned.robot.rest)


def random_configuration(planned: PlanningGroup, seed: int) -> np.ndarray:
    """A configuration within the limits, shape (nq,)."""
    return planned.random(np.random.default_rng(seed))


def box_arm(joints: str, links: int, size: float = 0.3) -> UrdfText:
    """A chain of box links; `joints` is one XML fragment per joint kind, see `JOINTS`."""
    kinds = [joints] * links if joints in JOINTS else joints.split()
    body = (
        '<link name="l{i}"><collision><origin xyz="0 0 {h}"/><geometry><box size="0.04 0.04 {w}"/></geometry>'
        "</collision></link>"
    )
    parts = [body.format(i=0, h=size / 2, w=0.9 * size)]
    for i, kind in enumerate(kinds, 1):
        parts.append(body.format(i=i, h=size / 2, w=0.9 * size))
        parts.append(JOINTS[kind].format(i=i, p=i - 1, z=size))
    return UrdfText(text=f'<robot name="arm">{"".join(parts)}</robot>')


_LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
_ENDS = '<origin xyz="0 0 {z}"/><parent link="l{p}"/><child link="l{i}"/>'
JOINTS = {
    "x": f'<joint name="j{{i}}" type="revolute">{_ENDS}<axis xyz="1 0 0"/>{_LIMIT}</joint>',
    "y": f'<joint name="j{{i}}" type="revolute">{_ENDS}<axis xyz="0 1 0"/>{_LIMIT}</joint>',
    "wide": f'<joint name="j{{i}}" type="revolute">{_ENDS}<axis xyz="0 1 0"/>'
    '<limit lower="-7" upper="7" effort="1" velocity="1"/></joint>',
    "oblique": f'<joint name="j{{i}}" type="revolute">{_ENDS}<axis xyz="1 2 -0.5"/>{_LIMIT}</joint>',
    "continuous": f'<joint name="j{{i}}" type="continuous">{_ENDS}<axis xyz="0 1 0"/></joint>',
    "oblique-continuous": f'<joint name="j{{i}}" type="continuous">{_ENDS}<axis xyz="1 2 -0.5"/></joint>',
    "slide": f'<joint name="j{{i}}" type="prismatic">{_ENDS}<axis xyz="0 0 1"/>{_LIMIT}</joint>',
    "mimic": f'<joint name="j{{i}}" type="revolute">{_ENDS}<axis xyz="0 1 0"/>{_LIMIT}'
    '<mimic joint="j1" multiplier="-0.5" offset="0.2"/></joint>',
    "gear": f'<joint name="j{{i}}" type="continuous">{_ENDS}<axis xyz="1 0 0"/>'
    '<mimic joint="j1" multiplier="-2" offset="0.2"/></joint>',
    "half-gear": f'<joint name="j{{i}}" type="continuous">{_ENDS}<axis xyz="0 1 0"/>'
    '<mimic joint="j1" multiplier="1.5" offset="-0.1"/></joint>',
    "screw": f'<joint name="j{{i}}" type="prismatic">{_ENDS}<axis xyz="0 0 1"/>{_LIMIT}'
    '<mimic joint="j1" multiplier="0.2" offset="-0.1"/></joint>',
    "planar": f'<joint name="j{{i}}" type="planar">{_ENDS}<axis xyz="0 0 1"/>{_LIMIT}</joint>',
    "tilted": f'<joint name="j{{i}}" type="planar">{_ENDS}<axis xyz="1 2 -0.5"/></joint>',
    "floating": f'<joint name="j{{i}}" type="floating">{_ENDS}</joint>',
}


def load(reference: UrdfText | UrdfFile) -> RobotModel:
    """A robot written in a test, or in files."""
    return _CATALOG.load(reference)


def grouped(reference: UrdfText, tip: str | None = None) -> PlanningGroup:
    """All joints of a robot written in a test, its base at the world's origin."""
    model = load(reference)
    return select(model, None, tip, model.rest, pin.SE3.Identity())
