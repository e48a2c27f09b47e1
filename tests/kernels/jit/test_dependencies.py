from pathlib import Path

import pytest

from guidefield import kernels
from guidefield.kernels.jit.cache import Sources

USES = {
    "from": "from guidefield.kernels.{0} import {0}\n{1} = {0}\n",
    "from the room": "from guidefield.kernels import {0}\n{1} = {0}.{0}\n",
    "several": "from guidefield.kernels.{0} import (\n    other,\n    {0},\n)\n{1} = {0}\n",
    "renamed": "from guidefield.kernels.{0} import {0} as short\n{1} = short\n",
    "renamed from the room": "from guidefield.kernels import {0} as short\n{1} = short.{0}\n",
    "whole": "import guidefield.kernels.{0}\n{1} = guidefield.kernels.{0}.{0}\n",
    "in a function": "def {1}():\n    from guidefield.kernels.{0} import {0}\n    return {0}()\n",
    "called": "from guidefield.kernels.{0} import {0}\n@decorated\ndef {1}():\n    return {0}()\n",
    "of a room": "from guidefield.kernels.room.{0} import {0}\n{1} = {0}\n",
}


def fingerprint(folder: Path, name: str = "first", also: str = "") -> str:
    return Sources(folder, "guidefield.kernels").fingerprint(name, also)


@pytest.mark.parametrize("form", USES)
def test_every_form_of_use_is_followed_to_the_end(tmp_path: Path, form: str) -> None:
    def fresh(value: str) -> str:
        folder = tmp_path / value
        within = folder / "room" if form == "of a room" else folder
        within.mkdir(parents=True)
        (folder / "first.py").write_text(USES[form].format("second", "first"))
        (within / "second.py").write_text(USES[form].format("third", "second"))
        (within / "third.py").write_text(f"third = {value}\n")
        return fingerprint(folder)

    assert fresh("1") != fresh("2")


def test_an_import_alone_is_no_dependency(tmp_path: Path) -> None:
    (tmp_path / "first.py").write_text("from guidefield.kernels.second import KIND\ndef first(x: KIND):\n    pass\n")
    second = tmp_path / "second.py"
    second.write_text("KIND = int\ndef formula():\n    return 1\n")
    before = fingerprint(tmp_path)
    second.write_text("KIND = int\ndef formula():\n    return 2\n")
    assert fingerprint(tmp_path) == before
    second.write_text("KIND = float\ndef formula():\n    return 2\n")
    assert fingerprint(tmp_path) != before


@pytest.mark.parametrize(
    "effect",
    ["register({})", "@overload(len)\ndef _(x):\n    return {}", "if True:\n    register({})", "table[0] = {}"],
)
def test_what_a_file_does_while_it_is_imported_counts_for_all_who_import_it(tmp_path: Path, effect: str) -> None:
    (tmp_path / "first.py").write_text("from guidefield.kernels.second import KIND\n")
    (tmp_path / "second.py").write_text("import guidefield.kernels.third\nKIND = int\n")
    third = tmp_path / "third.py"
    third.write_text(effect.format(1))
    before = fingerprint(tmp_path)
    third.write_text(effect.format(2))
    assert fingerprint(tmp_path) != before


def test_a_number_in_forward_kinematics_is_no_reason_to_compile_everything() -> None:
    sources = Sources(Path(kernels.__file__).parent, "guidefield.kernels")
    for file, name in (
        ("kinematics.forward_kinematics", "joint_placements"),
        ("kinematics.batch_forward_kinematics", "lane_placements"),
    ):
        again = [one for one in sources.names if (file, name) in sources._needed(one)]
        assert file in again
        assert len(again) <= len(sources.names) / 3
