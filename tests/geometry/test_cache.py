"""The disk cache: computed once, again after an edit or damage; its files of arrays are read as they were written."""

import ast
import functools
import logging
import os
import subprocess
import sys
from pathlib import Path

import coal
import numpy as np
import pytest

from guidefield.geometry import cache
from guidefield.geometry.cache import (
    MAPPED,
    Draft,
    allocate_in_memory,
    find_or_compute,
    folder,
    read_arrays,
    write_arrays,
)

SOURCES = Path(cache.__file__).parents[1]
INPUTS = {"points": np.arange(12.0).reshape(4, 3), "delta": np.array(0.015)}
RESULT = {
    "spheres": np.linspace(0, 1, 8).reshape(2, 4),
    "solid": np.array([True, False, True]),
    "first": np.arange(3),
    "nothing": np.empty((0, 3)),
    "links": np.arange(6, dtype=np.int32).reshape(3, 2),
    "text": np.frombuffer(b"what was odd", np.uint8),
}


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


class Counted:
    """Computes `RESULT`, and counts."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self) -> dict[str, np.ndarray]:
        self.times += 1
        return dict(RESULT)


def check(arrays: dict[str, np.ndarray]) -> None:
    assert set(arrays) == set(RESULT)
    for name, array in RESULT.items():
        assert arrays[name].dtype == array.dtype
        assert (arrays[name] == array).all()
        assert arrays[name].shape == array.shape
        assert not arrays[name].flags.writeable
        assert arrays[name].flags.aligned
        assert arrays[name].flags.c_contiguous


def entries() -> list[Path]:
    return sorted(folder().iterdir())


def test_it_is_computed_once(tmp_path: Path) -> None:
    make = Counted()
    for _ in range(3):
        check(find_or_compute("cover", INPUTS, make))
    assert make.times == 1
    assert [path.name.split("-")[0] for path in entries()] == ["cover"]
    assert entries()[0].is_relative_to(tmp_path / "guidefield" / "geometry")


def test_other_inputs_are_another_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    make = Counted()
    points = INPUTS["points"]
    others = [
        ("cover", INPUTS),
        ("inner", INPUTS),
        ("cover", {**INPUTS, "delta": np.array(0.016)}),
        ("cover", {**INPUTS, "delta": np.array([0.015])}),
        ("cover", {"points": points, "other": INPUTS["delta"]}),
        ("cover", {**INPUTS, "points": points.reshape(3, 4)}),
        ("cover", {**INPUTS, "points": points.view(np.int64)}),
    ]
    for kind, inputs in others:
        find_or_compute(kind, inputs, make)
    assert make.times == len(others)
    monkeypatch.setattr(cache, "_sources", lambda module: "edited")
    find_or_compute("cover", INPUTS, make)
    assert make.times == len(others) + 1


def test_an_edit_of_what_computes_is_another_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "guidefield"
    for name, text in {
        "robot/link_bounds": ("from guidefield.geometry import cover\nfrom guidefield.robot.model.model import Robot"),
        "robot/model/model": "",
        "geometry/cover": "import guidefield.kernels.greedy",
        "geometry/other": "",
        "kernels/greedy": "from guidefield.kernels.bits import ones",
        "kernels/bits": "ones = 1",
    }.items():
        path = package / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(cache, "_PACKAGE", package)
    monkeypatch.setattr(cache, "_sources", functools.cache(cache._sources.__wrapped__))  # the others keep what is real
    seen = {_fingerprint()}
    for name in ("kernels/bits", "geometry/cover", "robot/link_bounds"):
        with (package / f"{name}.py").open("a") as file:
            file.write("\n# edited")
        seen.add(_fingerprint())
    assert len(seen) == 4
    for name in ("geometry/other", "robot/model/model"):
        (package / f"{name}.py").write_text("# edited")
    assert _fingerprint() in seen


def test_hulls_of_another_coal_are_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hulls that an older Coal had found, with its faults, were read from disk."""
    monkeypatch.setattr(cache, "_sources", functools.cache(cache._sources.__wrapped__))
    before = _fingerprint()
    monkeypatch.setattr(coal, "__version__", "another")
    assert _fingerprint() != before


def _fingerprint() -> str:
    cache._sources.cache_clear()
    return cache._sources("guidefield.robot.link_bounds")


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:20],
        lambda content: content[:-1],
        lambda content: content[:40] + bytes([content[40] ^ 1]) + content[41:],
        lambda content: content + b"\0",
    ],
    ids=["empty", "short", "cut", "flipped", "longer"],
)
def test_a_damaged_entry_is_computed_again(damage, caplog: pytest.LogCaptureFixture) -> None:
    make = Counted()
    find_or_compute("cover", INPUTS, make)
    (path,) = entries()
    path.write_bytes(damage(path.read_bytes()))
    with caplog.at_level(logging.WARNING):
        check(find_or_compute("cover", INPUTS, make))
    assert "damaged" in caplog.text
    check(find_or_compute("cover", INPUTS, make))
    assert make.times == 2


def test_without_a_disk_it_is_computed_each_time(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "guidefield").write_text("a file where the folder should be")
    make = Counted()
    check(find_or_compute("cover", INPUTS, make))
    check(find_or_compute("cover", INPUTS, make))
    assert make.times == 2
    assert "cannot" in caplog.text


def test_what_was_unused_for_longest_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MOST_BYTES", 20_000)
    big = {"array": np.zeros(500)}
    for k in range(4):
        find_or_compute(f"k{k}", INPUTS, lambda: big)
        os.utime(entries()[-1], (k + 1e9, k + 1e9))
    find_or_compute("k0", INPUTS, lambda: pytest.fail("it is there"))  # used again, so that k1 is the oldest
    find_or_compute("k4", INPUTS, lambda: big)
    names = [path.name.split("-")[0] for path in entries()]
    assert "k0" in names
    assert "k4" in names
    assert "k1" not in names
    assert sum(path.stat().st_size for path in entries()) <= 20_000


WORKER = """
import sys
import numpy as np
from guidefield.geometry import cache
cache.MOST_BYTES = 300_000
rng = np.random.default_rng(int(sys.argv[1]))
for step in range(300):
    k = int(rng.integers(20))
    made = cache.find_or_compute("shared", {"k": np.array(k)}, lambda: {"array": np.full(3000, float(k))})
    assert (made["array"] == k).all() and len(made["array"]) == 3000
    if step % 37 == 0:
        some = sorted(cache.folder().glob("shared-*"))
        if some:
            some[k % len(some)].write_bytes(b"damaged")
"""


def test_several_processes_share_it() -> None:
    workers = [
        subprocess.Popen([sys.executable, "-c", WORKER, str(seed)], stderr=subprocess.PIPE, text=True)
        for seed in range(3)
    ]
    reports = [worker.communicate(timeout=600)[1] for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0], reports
    assert not [path for path in entries() if path.name.startswith(".")]


def test_what_a_source_names_is_what_python_reads_of_it() -> None:
    for path in (path for room in cache._PACKAGES for path in (SOURCES / room).rglob("*.py")):
        read, source = set[str](), path.read_text()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                read.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
            elif isinstance(node, ast.Import):
                read.update(alias.name for alias in node.names)
        assert {name for name in read if name.startswith(cache._COMPUTING)} == cache._find_named(source), path


MANY = 3 * MAPPED // 8
LAYOUT = {"numbers": ("<f8", (MANY,)), "kinds": ("<i4", (3, 5)), "none": ("<f4", (0, 2)), "some": ("|u1", (7,))}


def filled(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    for array in arrays.values():
        array[...] = rng.integers(0, 100, array.shape)
    return arrays


def check_arrays(arrays: dict[str, np.ndarray] | None, written: dict[str, np.ndarray]) -> None:
    assert list(arrays) == list(written)
    for name, array in arrays.items():
        assert array.dtype == written[name].dtype
        assert array.shape == written[name].shape
        assert array.tobytes() == written[name].tobytes()
        assert not array.flags.writeable
        assert array.flags.c_contiguous
        assert array.ctypes.data % array.itemsize == 0


def test_what_is_made_in_place_is_read_again(tmp_path: Path) -> None:
    path, wanted = tmp_path / "folder" / "entry", filled(allocate_in_memory(LAYOUT))
    draft = Draft(path)
    made = draft.allocate(LAYOUT)
    assert not any(array.any() for array in made.values())
    filled(made)
    assert read_arrays(path) is None, "it isn't whole yet"
    kept, size = draft.keep()
    draft.drop()
    assert size == path.stat().st_size > MAPPED
    check_arrays(kept, wanted)
    check_arrays(read_arrays(path), wanted)
    assert list(path.parent.iterdir()) == [path]
    in_place = path.read_bytes()
    write_arrays(path, wanted)
    assert path.read_bytes() == in_place, "it is the same file, whoever writes it"


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9999])
@pytest.mark.parametrize("bit", [0, 7])
def test_one_bit_that_is_another_is_found(share, bit, tmp_path, caplog):
    path = tmp_path / "entry"
    write_arrays(path, filled(allocate_in_memory(LAYOUT)))
    content = bytearray(path.read_bytes())
    content[int(share * len(content))] ^= 1 << bit
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert read_arrays(path) is None
    assert "damaged" in caplog.text
