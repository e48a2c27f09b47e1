"""Examine this machine: packages, clock, Zenoh on loopback and graphics, and whatever else a service needs."""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import datetime
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import guidefield
from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.doctor.resources import cores, memory, vectors
from guidefield.endpoint.link import DEFAULT_LISTEN, NoAnswer, is_taken, measure_answer
from guidefield.errors import DiskRefused
from guidefield.first_start import (
    KNOWN_NUMBA,
    PLAIN_VARIABLE,
    cache_parent,
    compiled_marker,
    plain_numba,
    processor,
)
from guidefield.stores.run_file import FILE, connect_reader, connect_writer, telling_faults
from guidefield.stores.runs import DEFAULT_RETENTION

GIB = 2**30
LEAST = GIB
"""With less a few recordings fill the disk [bytes]."""


def disk(data: Path) -> Finding:
    """Look whether the data folder takes files, and at the room on its disk.

    Args:
        data: Folder of a service's runs, scenes and robots; need not be there yet.
    """
    there = _there(data)
    if not there.is_dir():
        return wrong("disk", f"{there} is no folder", f"give `guidefield serve --data FOLDER`, or move {there} away")
    if not _takes_files(there):
        return wrong("disk", f"{there} can't be written", "give `guidefield serve --data FOLDER`, or the rights to it")
    return room_found(shutil.disk_usage(there).free, data)


def room_found(free: int, data: Path) -> Finding:
    """Judge the free room [bytes] for a data folder."""
    found = f"{free / GIB:.1f} GiB are free for {data}"
    if free < LEAST:
        return wrong("disk", found, "make room: on a full disk plans go on, but no run or recording is kept")
    if free < DEFAULT_RETENTION.bytes:
        return remark("disk", found, f"give `guidefield serve --keep-gib {max(1, free // (2 * GIB))}`, or make room")
    return fine("disk", found)


def runs(data: Path) -> Finding:
    """Look whether a database of runs can be written, and whether the one that is there is damaged.

    Args:
        data: Folder of a service's runs, scenes and robots; need not be there yet.
    """
    file, there = data / FILE, _there(data)
    try:
        with tempfile.TemporaryDirectory(prefix=".guidefield-", dir=there) as trial:
            connect_writer(Path(trial) / FILE).close()
    except (DiskRefused, OSError) as fault:
        return wrong("runs", f"a database in {there} is refused: {fault}", "give `guidefield serve --data FOLDER`")
    if not file.exists():
        if (data / "runs").is_dir():
            advice = "start the service: it takes them over"
            return remark("runs", f"{data / 'runs'} has runs that guidefield 0.1 kept in folders", advice)
        return fine("runs", f"none are kept in {data} yet; a database can be made there")
    try:
        with telling_faults(file), contextlib.closing(connect_reader(file)) as db:
            looked_at = "1" if file.stat().st_size < GIB else "'runs'"  # all of a larger one takes minutes
            (damage,) = db.execute(f"PRAGMA quick_check({looked_at})").fetchone()
            total = "SELECT count(*), ifnull(sum(bytes + recording), 0) FROM runs"
            count, size = db.execute(total).fetchone()
    except DiskRefused as fault:
        return wrong("runs", fault.message, "until then plans go on, but no run is kept")
    if damage != "ok":
        advice = f'stop the service and move it away, or mend it: sqlite3 {FILE} ".recover" | sqlite3 mended.sqlite'
        return wrong("runs", f"{file} is damaged: {damage}", advice)
    return fine("runs", f"{count} are kept in {file}, of {size / GIB:.1f} GiB with their recordings")


def kernels() -> Finding:
    """Look whether the kernels' machine code is there, or can be kept."""
    folder = cache_parent() / "guidefield"
    there = _there(folder)
    if not (there.is_dir() and _takes_files(there)):
        return wrong(
            "kernels",
            f"{there} can't be written: every start compiles for a minute",
            "set XDG_CACHE_HOME or NUMBA_CACHE_DIR to a folder that stays",
        )
    if not compiled_marker().exists():
        return remark(
            "kernels",
            f"not compiled for this version and processor ({processor()}) in {folder}",
            "the first start does it, for a minute; `python -m guidefield.kernels.jit.compile_ahead` does it now",
        )
    if plain_numba():
        return remark(
            "kernels",
            f"compiled by plain numba, as {PLAIN_VARIABLE} is set or its version is none of {', '.join(KNOWN_NUMBA)}",
            f"unset {PLAIN_VARIABLE}, or install one of these: the first start and plans take longer",
        )
    return fine("kernels", f"compiled for this processor ({processor()}), in {folder}")


def _takes_files(folder: Path) -> bool:
    """Look whether a file can be made in a folder: rights alone don't say it, least of all to root."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _there(path: Path) -> Path:
    """The path itself, or what is there of those above it."""
    return next((one for one in (path, *path.absolute().parents) if one.exists()), Path("/"))


def session() -> Finding:
    """Look whether a query on loopback is answered, and whether a service's own port is free."""
    try:
        seconds = measure_answer()
    except NoAnswer as error:
        return wrong(
            "zenoh",
            f"no answer on loopback: {error}",
            "look at the firewall's rules for lo, and at ZENOH_RUNTIME and ZENOH_CONFIG in the environment",
        )
    answered = f"a query on loopback is answered in {1e3 * seconds:.1f} ms"
    if is_taken(DEFAULT_LISTEN):
        return remark(
            "zenoh",
            f"{answered}; {DEFAULT_LISTEN} is taken",
            "if that isn't your service, give `guidefield serve --listen tcp/127.0.0.1:PORT`",
        )
    return fine("zenoh", answered)


WHOLE, LIGHT = "guidefield", "guidefield-client"


def packages() -> Finding:
    """Look whether one distribution of ours is installed, and not both."""
    return packages_found(_version(WHOLE), _version(LIGHT))


def packages_found(whole: str | None, light: str | None) -> Finding:
    """What is said about the versions of both that are installed; None where one isn't."""
    if whole is not None and light is not None:
        return wrong(
            "packages",
            f"{WHOLE} {whole} and {LIGHT} {light} share their files",
            f"`pip uninstall {LIGHT}`, then `pip install --force-reinstall --no-deps {WHOLE}`",
        )
    return fine("packages", f"{WHOLE} {whole}" if whole is not None else "from a folder, not installed")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
DEVICES = Path("/dev/dri")
WEB = "`guidefield show --web` shows recordings in a browser; the service needs no graphics"


def graphics() -> Finding:
    """Look whether the viewer can open a window."""
    loaders = [name for name in ("vulkan", "GL") if ctypes.util.find_library(name)]
    drivers = [file.stem for folder in DRIVERS if folder.is_dir() for file in sorted(folder.glob("*.json"))]
    devices = [file.name for file in sorted(DEVICES.glob("renderD*"))] if DEVICES.is_dir() else []
    return graphics_found(os.environ, loaders, drivers, devices)


def graphics_found(
    environment: Mapping[str, str], loaders: list[str], drivers: list[str], devices: list[str]
) -> Finding:
    """What is said about a display, libraries that load drivers, Vulkan's drivers, and devices that draw."""
    display = environment.get("WAYLAND_DISPLAY") or environment.get("DISPLAY")
    if not display:
        return remark("graphics", "no display", WEB)
    if not loaders:
        return remark(
            "graphics", f"display {display}, neither Vulkan nor OpenGL", f"install libvulkan1; until then {WEB}"
        )
    if "GL" not in loaders and not drivers:
        return remark("graphics", f"display {display}, Vulkan without a driver", f"install one; until then {WEB}")
    if not devices:
        return remark("graphics", f"display {display}, drawn by the processor", "the viewer is slow without a device")
    return fine("graphics", f"display {display}, {', '.join((*drivers, *devices)) or loaders[0]}")


UNSYNCHRONIZED = 5
"""TIME_ERROR: what the system says of a clock that nothing sets."""
SLACK = 86_400.0
"""How far behind the newest file of ours it may be, whose time another machine may have set [s]."""


def clock() -> Finding:
    """Look whether the clock is set, and by something that keeps it right."""
    ours = Path(guidefield.__file__).stat().st_mtime
    return clock_found(time.time(), ours, _system_state())


def clock_found(now: float, ours: float, state: int) -> Finding:
    """What is said about a clock.

    Args:
        now: What it says [s since 1970].
        ours: When guidefield was installed, by the time of its files [s since 1970].
        state: What the system says about it, as adjtimex(2) does; negative: nothing.
    """
    told = datetime.datetime.fromtimestamp(now, datetime.UTC).isoformat(sep=" ", timespec="seconds")
    if now < ours - SLACK:
        return wrong("clock", f"{told} is before guidefield was installed", "set it: `timedatectl set-time`, or NTP")
    if state == UNSYNCHRONIZED:
        return remark(
            "clock",
            f"{told}, kept right by nothing",
            "`timedatectl set-ntp true`, unless the host sets it: a clock that strays has certificates refused",
        )
    return fine("clock", told)


def _system_state() -> int:
    """What adjtimex(2) says, asked without changing anything; negative where it isn't allowed, or isn't there."""
    asked = ctypes.create_string_buffer(256)  # struct timex, all 0: nothing is set
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)  # Linux's own
    return -1 if adjtimex is None else int(adjtimex(asked))


def examination(data: Path) -> Iterator[Finding]:
    """What each look finds.

    Args:
        data: Folder of a service's runs, scenes and robots.
    """
    looks: dict[str, Callable[[], Finding]] = {
        "packages": packages,
        "cores": cores,
        "vectors": vectors,
        "memory": memory,
        "disk": partial(disk, data),
        "runs": partial(runs, data),
        "kernels": kernels,
        "clock": clock,
        "zenoh": session,
        "graphics": graphics,
    }
    for about, look in looks.items():
        yield _examine(about, look)


def _examine(about: str, look: Callable[[], Finding]) -> Finding:
    """What a look finds; that it can't look is a finding, too."""
    try:
        return look()
    except OSError as error:
        return wrong(about, f"can't be looked at: {error}", "guidefield runs on Linux, with /proc readable")
