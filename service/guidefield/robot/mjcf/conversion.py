"""An MJCF as a URDF, which the one loader of robots reads.

Pinocchio has a reader of MJCF, too; of 152 models that people publish it places 42 as MuJoCo does (version 4.1).
MuJoCo's own compiler is right by definition, and what it compiled is plain: a tree of bodies, joints, shapes and masks.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.mjcf import collision_pairs
from guidefield.robot.mjcf.compilation import CompiledModel, import_mujoco
from guidefield.robot.mjcf.equalities import joint_laws, tendon_warnings
from guidefield.robot.mjcf.geoms import GeomWriter
from guidefield.robot.mjcf.kinematic_tree import kinematic_tree
from guidefield.robot.mjcf.names import body_names, named
from guidefield.robot.urdf.srdf import Srdf, SrdfState


@dataclass(frozen=True, eq=False)
class MjcfRobot:
    """What an MJCF became.

    Attributes:
        urdf: The URDF, with a link for each body and named site, below the link `world`.
        semantics: Pairs of links that aren't tested, and keyframes, in the words of an SRDF.
        meshes: Files by the names that the URDF has for them.
        balls: Names of ball joints; the URDF calls them floating.
        joints: Name of each joint that moves, by MuJoCo's index.
        geoms: MuJoCo's indices of the geoms behind each link's <collision>, in their order.
        warnings: What isn't kept, or differs from what MuJoCo does.
    """

    urdf: str
    semantics: Srdf
    meshes: Mapping[str, Path]
    balls: tuple[str, ...]
    joints: Mapping[int, str]
    geoms: Mapping[str, Sequence[int]]
    warnings: tuple[str, ...]


def convert(compiled: CompiledModel, name: str, root_joint: str) -> MjcfRobot:
    """Write a compiled MJCF as a URDF.

    Args:
        compiled: What MuJoCo made of it.
        name: Of the robot.
        root_joint: `fixed`: bodies with free joints stand where the file has them; `free`: they move, or the whole
            robot if it has none; `planar`: the whole robot moves.

    Raises:
        RobotInvalid: if it has a part that can't be judged or planned for as it is; names it.
    """
    model, warnings = compiled.model, list(compiled.warnings)
    if model.nflex:
        which = ", ".join(repr(name) for name in named(model, "flex") if name)
        raise RobotInvalid(
            f"MJCF: it has a <flex>{' called ' + which if which else ''}, a body that bends, which can't be judged;"
            " take it out"
        )
    laws = joint_laws(model, warnings)
    tree = kinematic_tree(model, laws, root_joint == "free", name)
    warnings += _held_bodies(model, tree.joints)
    warnings += tendon_warnings(model)
    geoms = GeomWriter(model, tree.links)
    in_place = root_is_fixed(model, root_joint)
    geoms.write(in_place)
    if geoms.scenery:
        warnings.append(
            f"planes and height fields are no part of a robot, and left out: {', '.join(geoms.scenery)}; "
            "declare the ground as an obstacle"
        )
    if not in_place and model.body_geomnum[0]:
        warnings.append("the shapes of the world's body are left out: the root moves, and they don't")
    rest = collision_pairs.rest_configuration(model)
    disabled = collision_pairs.disabled_pairs(model, geoms.collisions, rest, warnings)
    states = [
        SrdfState(state, "", collision_pairs.positions(model, tree.joints, q), 0)
        for state, q in collision_pairs.keyframe_states(model).items()
    ]
    return MjcfRobot(
        urdf=etree.tostring(tree.robot, encoding="unicode", pretty_print=True),
        semantics=Srdf(states=tuple(states), disabled=disabled, said_by="MJCF"),
        meshes=geoms.meshes,
        balls=tree.balls,
        joints=tree.joints,
        geoms=geoms.collisions,
        warnings=tuple(warnings),
    )


def root_is_fixed(model: Any, root_joint: str) -> bool:
    """Return True if the link `world` stands still: nothing but the file's own joints moves the robot."""
    return root_joint == "fixed" or (root_joint == "free" and bool(_free_joints(model)))


def _free_joints(model: Any) -> list[int]:
    free = import_mujoco().mjtJoint.mjJNT_FREE
    return [joint for joint in range(model.njnt) if model.jnt_type[joint] == free]


def _held_bodies(model: Any, moving: Collection[int]) -> list[str]:
    """A sentence about bodies whose free joints don't move, if there are such."""
    names = body_names(model)
    held = [names[model.jnt_bodyid[joint]] for joint in _free_joints(model) if joint not in moving]
    if not held:
        return []
    return [f'free joints stand still where the MJCF has them: {", ".join(held)}; root_joint "free" lets them move']
