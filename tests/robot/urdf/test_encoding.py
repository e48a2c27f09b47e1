"""Robots in files of other encodings are read as XML says; what isn't what it declares is refused with its place."""

import codecs
from pathlib import Path

import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.robot.urdf.xml import read_xml
from tests.robots import load

BODY = '<collision><geometry><box size="0.2 0.02 0.02"/></geometry></collision>'
ROBOT = (
    f'<robot name="n"><link name="w"/>\n<link name="bé">{BODY}</link><joint name="j" type="continuous">'
    '<parent link="w"/><child link="bé"/><axis xyz="0 0 1"/></joint></robot>'
)


def declared(encoding: str) -> str:
    return f'<?xml version="1.0" encoding="{encoding}"?>{ROBOT}'


READ = {
    "latin-1": declared("ISO-8859-1").encode("latin-1"),
    "windows": declared("windows-1252").encode("cp1252"),
    "UTF-16 with a mark": declared("UTF-16").encode("utf-16"),
    "UTF-16, the mark alone": ROBOT.encode("utf-16"),
    "UTF-16 without a mark": declared("UTF-16").encode("utf-16-be"),
    "UTF-8 with a mark": codecs.BOM_UTF8 + ROBOT.encode(),
    "UTF-8": ROBOT.encode(),
}
REFUSED = {
    "latin-1 that declares nothing": (ROBOT.encode("latin-1"), 46, "line 2: 'r.urdf' isn't UTF-8 at byte 46 (0xe9)"),
    "latin-1 that declares UTF-8": (declared("UTF-8").encode("latin-1"), 84, "isn't UTF-8 at byte 84"),
    "UTF-16 that says nothing": (ROBOT.encode("utf-16-le"), 0, "'r.urdf' is UTF-16 from byte 0 on without saying so"),
    "an unknown encoding": (declared("klingon").encode(), None, "declares the unknown encoding 'klingon'"),
    "no encoding of text": (declared("hex").encode(), None, "declares the unknown encoding 'hex'"),
}


@pytest.mark.parametrize("case", READ)
def test_a_file_is_read_in_its_encoding(case: str, tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(READ[case])
    assert load(UrdfFile(path=str(file))).links == ("w", "bé")


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_is_not_what_it_says_is_refused(case: str, tmp_path: Path) -> None:
    content, byte, words = REFUSED[case]
    file = tmp_path / "r.urdf"
    file.write_bytes(content)
    with pytest.raises(RobotInvalid) as refused:
        read_xml(file)
    assert words in refused.value.message
    assert refused.value.details.get("byte") == byte
    robot = tmp_path / "sound.urdf"
    robot.write_text(ROBOT, encoding="utf-8")
    with pytest.raises(RobotInvalid, match=r"'r\.urdf'"):
        load(UrdfFile(path=str(robot), srdf_path=str(file)))


def test_a_text_that_declares_another_encoding_is_text() -> None:
    assert load(UrdfText(text=declared("ISO-8859-1"))).links == ("w", "bé")
