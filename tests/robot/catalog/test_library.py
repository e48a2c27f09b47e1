"""The catalog: every URDF has a name, those of one package are a family, and a card says what its robot has."""

from __future__ import annotations

from pathlib import Path

import pytest

from guidefield.errors import RobotInvalid
from guidefield.robot.catalog import library
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.urdf.urdf_validation import check_urdf

ENTRIES = library.entries()


def test_every_urdf_of_the_package_has_exactly_one_name() -> None:
    robots = catalog_share() / CATALOG_PACKAGE / "robots"
    there = sorted(str(path.relative_to(robots)) for path in robots.rglob("*.urdf"))
    named = sorted(entry.card.urdf for entry in ENTRIES.values() if entry.source == CATALOG_PACKAGE)
    assert named == there
    assert len(there) == 69


def test_srdfs_are_found_by_names_that_fit() -> None:
    found = {name: entry.card.srdf and Path(entry.card.srdf).stem for name, entry in ENTRIES.items()}
    assert found["baxter"] == "baxter_manipulation"
    assert found["talos_reduced_corrected"] == "talos"
    assert found["ur5_gripper"] == "ur5_gripper"
    assert found["pr2"] == "pr2"
    assert found["solo12"] is None, "that of solo is about another robot"
    assert found["anymal_c_simple"] == "anymal"


def test_variants_are_a_family_and_its_name_leads_to_them() -> None:
    family = {entry.name for entry in ENTRIES.values() if entry.family == "talos"}
    assert {"talos_full_v2", "talos_reduced", "talos_left_arm"} <= family
    with pytest.raises(RobotInvalid, match="there are talos_full_v2, ") as unknown:
        Catalog().load("talos")
    assert set(unknown.value.details["available"]) == family


@pytest.mark.parametrize("name", [name for name, entry in ENTRIES.items() if entry.card.tip is not None])
def test_what_a_card_names_is_there(name: str) -> None:
    entry = ENTRIES[name]
    path = entry.folder / entry.card.urdf
    facts = check_urdf(path.read_text(), MeshResolver.for_file(path))
    joints = {*facts.joints, "root_joint"}
    assert entry.card.tip in facts.links
    assert joints >= {*(entry.card.group or ()), *entry.card.rest, *entry.card.ball_joints}
    assert joints >= {*entry.card.velocity, *entry.card.acceleration}
    assert entry.card.srdf is None or srdf.parse((entry.folder / entry.card.srdf).read_text())
