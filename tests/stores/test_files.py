from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import MalformedRequest
from guidefield.stores.files import checked_name, default_data_folder, read_if_any


@given(st.text(max_size=200))
@settings(max_examples=60)
def test_a_name_that_is_accepted_stays_in_its_folder(name: str) -> None:
    folder = Path("/data/scenes")
    try:
        path = folder / f"{checked_name(name, 'scene')}.json"
    except MalformedRequest:
        return
    assert path.parent == folder
    assert path.resolve().parent == folder.resolve()
    assert path.name == f"{name}.json"
    assert not path.name.startswith(".")


@pytest.mark.parametrize("name", ["..", ".", "", "../x", "a/b", "a\\b", ".hidden", "a\0b", "a\n", "x" * 129, "ä"])
def test_names_that_could_lead_elsewhere_are_refused(name: str) -> None:
    with pytest.raises(MalformedRequest, match="scene"):
        checked_name(name, "scene")


def test_what_is_not_there_reads_as_none(tmp_path: Path) -> None:
    assert read_if_any(tmp_path / "nothing") is None


def test_the_data_folder_follows_the_platform_and_the_instance(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_data_folder("cell-7") == tmp_path / "guidefield" / "cell-7"
    monkeypatch.delenv("XDG_DATA_HOME")
    assert default_data_folder("local") == Path.home() / ".local" / "share" / "guidefield" / "local"
    with pytest.raises(MalformedRequest):
        default_data_folder("../elsewhere")
