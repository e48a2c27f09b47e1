"""The library: every URDF has a name, those of one package are a family; robot_descriptions answers or says why not."""

import time
from pathlib import Path

import pytest

from guidefield.engine import Engine, LocalFiles
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import ReadRobot
from guidefield.robot import library
from guidefield.robot.catalog import Catalog
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.urdf.urdf_validation import check_urdf
from tests.robots import box_arm

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


@pytest.fixture
def descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of the same name and form, which is found before the installed one."""
    package = tmp_path / "path" / "robot_descriptions"
    package.mkdir(parents=True)
    names = ("arm_description", "slow_description", "away_description", "empty_description")
    package.joinpath("__init__.py").write_text(f"DESCRIPTIONS = dict.fromkeys({names})")
    package.joinpath("slow_description.py").write_text("import time; time.sleep(60)")
    package.joinpath("away_description.py").write_text("raise OSError('x\\nfatal: Could not resolve host')")
    package.joinpath("empty_description.py").write_text("")
    repository = tmp_path / "cache" / "arms"
    (repository / "arm_description" / "urdf").mkdir(parents=True)
    urdf = repository / "arm_description" / "urdf" / "arm.urdf"
    urdf.write_text(box_arm("y y", 2).text)
    package.joinpath("arm_description.py").write_text(
        f"print('Cloning ...')\nREPOSITORY_PATH = {str(repository)!r}\n"
        f"PACKAGE_PATH = REPOSITORY_PATH + '/arm_description'\nURDF_PATH = PACKAGE_PATH + '/urdf/arm.urdf'\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    vars(library.find_description.__wrapped__).pop("_found", None)  # frees what other tests found
    return urdf


def test_a_description_is_found_by_its_loader(descriptions: Path) -> None:
    catalog = Catalog()
    robot = catalog.load("robot_descriptions:arm_description")
    assert robot.source.urdf_path == descriptions
    assert len(robot.joints) == 2
    assert catalog.load("robot_descriptions:arm_description") is robot
    folders = library.find_description("robot_descriptions:arm_description").package_dirs
    assert folders == [str(descriptions.parents[2]), str(descriptions.parents[3])]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("away_description", r"could not load 'away_description': .*Could not resolve host.*pull away_description"),
        ("arm", r"has no 'arm'; did you mean arm_description\?"),
        ("empty_description", "neither URDF nor MJCF"),
        ("../os", "is no name"),
        ("", "is no name"),
    ],
)
def test_what_cant_be_had_is_told_in_a_sentence(descriptions: Path, name: str, words: str) -> None:
    with pytest.raises(RobotInvalid, match=words) as caught:
        Catalog().load(f"robot_descriptions:{name}")
    assert "Traceback" not in caught.value.message


def test_a_download_without_end_is_ended(descriptions: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "MAX_DOWNLOAD_SECONDS", 1.0)
    began = time.monotonic()
    with pytest.raises(RobotInvalid, match="took more than 1 s"):
        Catalog().load("robot_descriptions:slow_description")
    assert time.monotonic() - began < 30.0


def test_where_the_package_is_missing_the_command_to_install_it_is_told(descriptions, monkeypatch):
    package = descriptions.parents[4] / "path" / "robot_descriptions" / "__init__.py"
    package.write_text("raise ImportError('No module named git')")
    with pytest.raises(RobotInvalid, match=r"pip install 'guidefield\[robot_descriptions\]'"):
        Catalog().load("robot_descriptions:arm_description")


def test_a_service_refuses_them(descriptions: Path) -> None:
    engine = Engine(local_files=LocalFiles.REFUSED)
    with pytest.raises(RobotInvalid, match="in Python and on the command line only"):
        engine.answer(ReadRobot("robot_descriptions:arm_description"))
