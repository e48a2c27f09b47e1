"""Files of a store: names stay in their folder; full disks and cut files are told, and what was kept stays whole."""

import contextlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from guidefield.engine import Engine
from guidefield.errors import DiskRefused, MalformedRequest, RobotInvalid, SceneInvalid, UnknownObject, WorkerCrashed
from guidefield.handlers.robots import robots
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import make_error_reply
from guidefield.messages.requests import ReadRuns, RobotFiles, StoreRobot, StoreScene
from guidefield.messages.scene import Box, Scene, Sphere
from guidefield.rendering import whole_recording
from guidefield.robot.catalog import Catalog
from guidefield.stores import run_file
from guidefield.stores.files import checked_name, default_data_folder, read_if_any
from guidefield.stores.recordings import Recordings
from guidefield.stores.robots import RobotStore
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase
from guidefield.stores.scenes import SceneStore
from tests.kept_runs import begin, keep, new_run
from tests.replies import plan_reply
from tests.robots import box_arm

ARM = RobotFiles(urdf=box_arm("y", 2).text)


def _cut(file: Path) -> list[int]:
    """Lengths to cut a file to: those near its ends, and some between."""
    size = file.stat().st_size
    return sorted({0, 1, 2, size - 1, size - 2, *range(3, size, max(1, size // 12))})


def test_a_damaged_recording_is_told(tmp_path: Path) -> None:
    recordings = Recordings(tmp_path)
    for content in (b"", b"RRF2 and nothing that follows"):
        recordings.path("damaged").write_bytes(content)
        with pytest.raises(UnknownObject, match="recording of run 'damaged' is damaged"):
            whole_recording(recordings, "damaged")


@pytest.mark.parametrize("folder", ["names", "contents"])
def test_a_damaged_robot_is_told_in_the_list_and_stored_again(folder: str, tmp_path: Path) -> None:
    store, catalog = RobotStore(tmp_path / "robots"), Catalog()
    store.write("whole", ARM, catalog.load)
    store.write("damaged", RobotFiles(urdf=box_arm("y", 3).text), catalog.load)
    if folder == "names":
        file = tmp_path / "robots" / "names" / "damaged"
    else:
        content = (tmp_path / "robots" / "names" / "damaged").read_text()
        file = tmp_path / "robots" / "contents" / content / "robot.json"
    written = file.read_bytes()
    for length in (0, len(written) // 2):
        file.write_bytes(written[:length])
        lines = {line.name: line.problem for line in robots(catalog, store).robots if line.source == "stored"}
        assert set(lines) == {"whole", "damaged"}
        assert lines["whole"] is None
        assert "damaged" in (lines["damaged"] or "")
        with pytest.raises(RobotInvalid, match="store it again"):
            store.find("damaged")
    store.write("damaged", RobotFiles(urdf=box_arm("y", 3).text), catalog.load)
    assert catalog.load(store.find("damaged")).name == "damaged"


def test_a_name_that_leads_elsewhere_is_damaged(tmp_path: Path) -> None:
    store = RobotStore(tmp_path / "robots")
    store.write("mine", ARM, Catalog().load)
    (tmp_path / "robots" / "names" / "mine").write_bytes(b"../names\xff")
    with pytest.raises(RobotInvalid, match="damaged"):
        store.find("mine")
    store.delete("mine")
    assert store.names() == []


def test_a_damaged_scene_is_told_and_stored_again(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    scene = Scene("shelf", obstacles=[Box(name="b", size=(0.1, 0.1, 0.1))])
    store.write(scene)
    file = tmp_path / "shelf.json"
    written = file.read_bytes()
    for length in _cut(file):
        file.write_bytes(written[:length])
        assert "shelf" in store.names()
        with pytest.raises(SceneInvalid, match="damaged"):
            store.read("shelf")
    store.write(scene)
    assert store.read("shelf")[0] == scene


ROOM = 768  # of the disk [KiB]: for a few requests and replies, and no more than a recording or two


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}k", "tmpfs", str(tmp_path)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("a small disk can't be mounted here; that takes root")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


def _filled(disk: Path) -> Path:
    """A file that takes all the room that is left."""
    filler = disk / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
    return filler


def test_a_full_disk_is_told_and_what_was_kept_stays(small_disk: Path) -> None:
    database = RunDatabase(small_disk)
    runs = database.of(PLAIN)
    keep(database, "before")
    running = begin(database, "running")
    assert runs.list(ReadRuns()).total == 2
    filler = _filled(small_disk)
    kept = {"before"}
    for number in range(200):  # the file has some room left inside
        run = new_run(f"r{number}")
        if runs.finish(run, codec.encode(plan_reply(run.run_id))).exception() is not None:
            break
        kept.add(run.run_id)
    with pytest.raises(DiskRefused, match=r"^the disk refuses: No space left on device$"):
        runs.finish(running, b" " * 100_000 + codec.encode(plan_reply("running"))).result()
    assert {run.run_id for run in runs.list(ReadRuns()).runs} == kept, "nor does it seem to be under way"
    assert runs.list(ReadRuns()).total == len(kept)
    assert not runs.has("running")
    filler.unlink()
    until = time.monotonic() + 30.0
    while database.unended:
        assert time.monotonic() < until
        time.sleep(0.01)
    keep(database, "after")
    assert {run.run_id for run in runs.list(ReadRuns()).runs} == {*kept, "after"}
    assert runs.read("before").reply == plan_reply("before")
    database.close()


def test_a_disk_that_is_full_from_the_start_is_told_and_used_once_it_has_room(small_disk, monkeypatch):
    monkeypatch.setattr(run_file, "RETRY_INTERVAL_S", 0.0)
    monkeypatch.setattr(run_file, "UPKEEP_INTERVAL_S", 0.02)
    database = RunDatabase(small_disk)
    begin(database, "abandoned")
    database.close()
    filler = _filled(small_disk)
    database = RunDatabase(small_disk)
    with pytest.raises(DiskRefused, match="disk"):
        database.sweep(make_error_reply(WorkerCrashed("left behind")))
    with pytest.raises(DiskRefused, match="disk"):
        keep(database, "r1")
    filler.unlink()
    running = begin(database, "running")
    keep(database, "r2")
    until = time.monotonic() + 30.0
    while database.of(PLAIN).read("abandoned").error is None:  # what the start could not do is done now
        assert time.monotonic() < until
        time.sleep(0.01)
    listed = database.of(PLAIN).list(ReadRuns()).runs
    assert {run.run_id: run.status for run in listed} == {"abandoned": "CRASH", "r2": "SUCCESS", "running": "RUNNING"}
    database.of(PLAIN).discard(running).result()
    database.close()


def test_a_database_that_stays_damaged_is_told_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(run_file, "UPKEEP_INTERVAL_S", 0.01)
    (tmp_path / FILE).write_bytes(b"no database" * 1_000)
    database = RunDatabase(tmp_path)
    with pytest.raises(DiskRefused, match="damaged"):
        database.sweep(make_error_reply(WorkerCrashed("left behind")))
    tried = 0

    def sweep(*_: object) -> None:
        nonlocal tried
        tried += 1
        raise DiskRefused("it is damaged")

    monkeypatch.setattr(database, "sweep", sweep)
    until = time.monotonic() + 30.0
    while tried < 5 and time.monotonic() < until:
        time.sleep(0.01)
    database.close()
    assert tried >= 5
    assert sum("it is damaged" in record.message for record in caplog.records) == 1


def test_a_store_on_a_full_disk_says_so_without_a_path(small_disk: Path) -> None:
    engine = Engine(scenes=SceneStore(small_disk / "scenes"), robots=RobotStore(small_disk / "robots"))
    _filled(small_disk)
    for request in (
        StoreScene("ball", Scene("ball", obstacles=[Sphere(name="ball", radius=0.1)])),
        StoreRobot("arm", RobotFiles(urdf=box_arm("y", 2).text)),
    ):
        with pytest.raises(DiskRefused, match=r"^the disk refuses: No space left on device$"):
            engine.answer(request)
    assert not list((small_disk / "robots" / "contents").iterdir())


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
