"""One line about a robot of the catalog, without loading its shapes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.messages.replies import RobotSummary
from guidefield.robot import srdf
from guidefield.robot.card import RobotCard
from guidefield.robot.intake import check_urdf
from guidefield.robot.loading import default_tip
from guidefield.robot.meshes import MeshResolver
from guidefield.robot.native_stderr import captured_stderr

MOVABLE = ("revolute", "continuous", "prismatic", "planar", "floating")


def summarize(name: str, source: str, folder: Path, card: RobotCard) -> RobotSummary:
    """Joints, groups and tip of a robot; or what is wrong with it.

    Args:
        name: What the catalog calls it.
        source: Where it comes from.
        folder: Folder of the card's paths.
        card: Its files and defaults.
    """
    path = folder / card.urdf
    try:
        facts = check_urdf(path.read_text(), MeshResolver.for_file(path))
        described = srdf.parse((folder / card.srdf).read_text()) if card.srdf else srdf.Srdf()
        with captured_stderr():
            model = pin.buildModelFromXML(facts.text)
    except (RobotInvalid, ValueError) as error:
        return RobotSummary(name=name, source=source, problem=str(error))
    planned = [joint for joint in facts.joints.values() if joint.kind in MOVABLE and joint.name not in facts.mimics]
    problem = None if facts.collisions else "it has no collision geometry"
    return RobotSummary(
        name=name,
        source=source,
        dof=int(model.nv) - len(facts.mimics),
        joint_kinds=dict(Counter(joint.kind for joint in planned)),
        groups=sorted(described.groups),
        tip=default_tip(model, described, card),
        problem=problem,
    )
