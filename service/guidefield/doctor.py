"""Examine this machine: packages, processors, memory, disk, runs, kernels, clock, Zenoh on loopback, graphics.

`guidefield doctor` prints the findings. Where a function measures, one named `…_found` judges, so that tests can give
it other machines. A new subject is a line in `examination`. Numbers here change what is advised alone, and with `WRONG`
the command's exit code: no service reads them.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import datetime
import enum
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

import guidefield
from guidefield.endpoint.link import DEFAULT_LISTEN, NoAnswer, is_taken, measure_answer
from guidefield.errors import DiskRefused
from guidefield.first_start import (
    KNOWN_NUMBA,
    PLAIN_VARIABLE,
    SHIPPED,
    cache_parent,
    compiled_marker,
    find_shipped,
    kernels_fingerprint,
    level,
    list_shipped,
    plain_numba,
    processor,
)
from guidefield.parallel import usable_processors
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.stores.run_file import FILE, connect_reader, connect_writer, telling_faults
from guidefield.stores.runs import DEFAULT_RETENTION


class FindingState(enum.StrEnum):
    """The state of a subject."""

    FINE = "fine"
    REMARK = "remark"
    """It works, but less well than it could, or not everything does."""
    WRONG = "wrong"
    """A service doesn't start or answer, or can't keep what it makes."""


@dataclass(frozen=True)
class Finding:
    """A finding about a subject: its state, what is there and, unless it is fine, what to do, each in a sentence."""

    about: str
    state: FindingState
    found: str
    advice: str = ""


def fine(about: str, found: str) -> Finding:
    """Return a finding about which nothing is to be done."""
    return Finding(about, FindingState.FINE, found)


def remark(about: str, found: str, advice: str) -> Finding:
    """Return a finding that could be better."""
    return Finding(about, FindingState.REMARK, found, advice)


def wrong(about: str, found: str, advice: str) -> Finding:
    """Return a finding about which something has to be done."""
    return Finding(about, FindingState.WRONG, found, advice)


ROOT = Path("/sys/fs/cgroup")  # folder of the control groups' files
OWN = Path("/proc/self/cgroup")  # file that names the control groups of this process


def processor_quota(root: Path = ROOT, own: Path = OWN) -> float | None:
    """Return the number of processors that the control groups of this process allow; None without such a limit."""
    found = []
    for folder in _folders(root, own):
        share, _, period = _read(folder / "cpu.max").partition(" ")
        if share.isdecimal() and period.isdecimal():
            found.append(int(share) / int(period))
        quota, period = _read(folder / "cpu.cfs_quota_us"), _read(folder / "cpu.cfs_period_us")
        if quota.isdecimal() and period.isdecimal():
            found.append(int(quota) / int(period))
    return min(found, default=None)


def memory_limit(root: Path = ROOT, own: Path = OWN) -> int | None:
    """Return the memory that the control groups of this process allow [bytes]; None without such a limit."""
    found = [_read(folder / name) for folder in _folders(root, own) for name in ("memory.max", "memory.limit_in_bytes")]
    limits = [int(limit) for limit in found if limit.isdecimal() and int(limit) < 1 << 60]
    return min(limits, default=None)


def _folders(root: Path, own: Path) -> Iterator[Path]:
    for line in _read(own).splitlines():
        _, names, path = line.split(":", 2)
        above = root if not names else root / names
        group = above / path.lstrip("/")
        while True:
            yield group
            if group in (above, group.parent):
                break
            group = group.parent


def _read(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""


MIN_PROCESSORS = 2  # with fewer a worker and the service's own process wait for each other
WIDE = ("avx512f", "avx2", "asimd")
"""Vector instructions that the kernels' sixteen lanes are made for, the widest first."""


def cores() -> Finding:
    """Count the processors that this process may use."""
    return cores_found(usable_processors(), processor_quota())


def cores_found(allowed: int, quota: float | None) -> Finding:
    """Judge the number of processors, and how many of them a container may use at once."""
    there = f"{allowed} to run on" + ("" if quota is None else f", the container may use {quota:g} at once")
    if quota is not None and quota < allowed:
        workers = max(1, int(quota))
        return remark("cores", there, f"give `guidefield serve --workers {workers}`: more only wait for one another")
    if allowed < MIN_PROCESSORS:
        return remark("cores", there, "a second core keeps answers quick while a plan is made")
    return fine("cores", there)


def vectors(cpuinfo: Path = Path("/proc/cpuinfo"), machine: str | None = None) -> Finding:
    """Examine the processors' vector instructions, by Linux' cpuinfo and the family of processors."""
    if cpuinfo.exists():
        text = cpuinfo.read_text()
        flags = set(" ".join(re.findall(r"^(?:flags|Features)\s*:(.*)$", text, re.MULTILINE)).split())
    elif (machine or platform.machine()) in ("arm64", "aarch64"):
        flags = {"asimd"}  # each 64-bit one has it
    else:
        return fine("vectors", "this system doesn't say which")
    widest = next((name for name in WIDE if name in flags), None)
    if widest is None:
        return remark(
            "vectors",
            f"none of {', '.join(WIDE)}",
            "plans are right and take several times as long; a virtual machine may hide them: pass the host's through",
        )
    if widest == "avx2" and "fma" not in flags:
        return remark(
            "vectors", "avx2 without fma", "plans are right and take longer; pass the host's processor through"
        )
    return fine("vectors", widest)


SERVICE_TAKES = 704 * 2**20
"""Memory of the service's own process, and the one that renders recordings; 110 and 410 MiB were measured [bytes]."""
WORKER_TAKES = 768 * 2**20
"""Memory of a worker; a fresh one had 420 MiB, after plans for two arms of meshes 500 MiB [bytes]."""


def memory() -> Finding:
    """Examine the memory that a service and its workers may have."""
    there = psutil.virtual_memory()
    return memory_found(there.total, there.available, memory_limit(), usable_processors())


def memory_found(total: int, available: int, limit: int | None, workers: int) -> Finding:
    """Judge memory: in total, free for new processes, of the container's limit, if any [bytes], for some workers."""
    most = total if limit is None else min(total, limit)
    free = min(available, most)
    there = f"{free / GIB:.1f} of {most / GIB:.1f} GiB are free"
    fit = (free - SERVICE_TAKES) // WORKER_TAKES
    if fit < 1:
        return wrong("memory", there, f"a service with one worker needs {(SERVICE_TAKES + WORKER_TAKES) / GIB:.1f} GiB")
    if fit < workers:
        return remark("memory", there, f"give `guidefield serve --workers {fit}`, instead of {workers}")
    if workers * DEFAULT_MEMORY > most:
        each = (most - SERVICE_TAKES) // workers >> 20
        return remark("memory", there, f"give `guidefield serve --memory {each}`, so that no request takes it all")
    return fine("memory", there)


GIB = 2**30
MIN_FREE_BYTES = GIB  # free room that a data folder needs; with less a few recordings fill the disk


def disk(data: Path) -> Finding:
    """Examine whether the data folder, which need not be there yet, takes files, and the room on its disk."""
    there = _there(data)
    if not there.is_dir():
        return wrong("disk", f"{there} is no folder", f"give `guidefield serve --data FOLDER`, or move {there} away")
    if not _takes_files(there):
        return wrong("disk", f"{there} can't be written", "give `guidefield serve --data FOLDER`, or the rights to it")
    return room_found(shutil.disk_usage(there).free, data)


def room_found(free: int, data: Path) -> Finding:
    """Judge the free room [bytes] for a data folder."""
    found = f"{free / GIB:.1f} GiB are free for {data}"
    if free < MIN_FREE_BYTES:
        return wrong("disk", found, "make room: on a full disk plans go on, but no run or recording is kept")
    if free < DEFAULT_RETENTION.bytes:
        return remark("disk", found, f"give `guidefield serve --keep-gib {max(1, free // (2 * GIB))}`, or make room")
    return fine("disk", found)


def runs(data: Path) -> Finding:
    """Examine whether a database of runs can be written, and whether an existing one is damaged."""
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
    """Examine whether the kernels' machine code is there, or can be kept."""
    folder = cache_parent() / "guidefield"
    there = _there(folder)
    if not (there.is_dir() and _takes_files(there)):
        return wrong(
            "kernels",
            f"{there} can't be written: every start compiles for a minute",
            "set XDG_CACHE_HOME or NUMBA_CACHE_DIR to a folder that stays",
        )
    target = level() or f"this very processor ({processor()})"
    if not compiled_marker().exists():
        if find_shipped(kernels_fingerprint()) is not None:
            return fine("kernels", f"shipped for {target}; the first start unpacks them into {folder}")
        shipped = ", ".join(list_shipped())
        return remark(
            "kernels",
            f"not compiled for {target} in {folder}" + (f"; none that is shipped fits: {shipped}" if shipped else ""),
            "the first start does it, for a minute; `python -m guidefield.kernels.jit.compile_ahead` does it now",
        )
    if plain_numba():
        return remark(
            "kernels",
            f"compiled by plain numba, as {PLAIN_VARIABLE} is set or its version is none of {', '.join(KNOWN_NUMBA)}",
            f"unset {PLAIN_VARIABLE}, or install one of these: the first start and plans take longer",
        )
    made = "shipped" if compiled_marker().read_text() == SHIPPED else "compiled here"
    return fine("kernels", f"{made}, for {target}, in {folder}")


def _takes_files(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _there(path: Path) -> Path:
    return next((one for one in (path, *path.absolute().parents) if one.exists()), Path("/"))


def session() -> Finding:
    """Examine whether a query on loopback is answered, and whether a service's own port is free."""
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
    """Examine whether one distribution of ours is installed, and not both."""
    return packages_found(_version(WHOLE), _version(LIGHT))


def packages_found(whole: str | None, light: str | None) -> Finding:
    """Judge the installed versions of both distributions; None for one that isn't installed."""
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


DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))  # folders that list Vulkan's drivers
DEVICES = Path("/dev/dri")  # folder of the devices that draw
WEB = "`guidefield show --web` shows recordings in a browser; the service needs no graphics"


def graphics() -> Finding:
    """Examine whether the viewer can open a window."""
    loaders = [name for name in ("vulkan", "GL") if ctypes.util.find_library(name)]
    drivers = [file.stem for folder in DRIVERS if folder.is_dir() for file in sorted(folder.glob("*.json"))]
    devices = [file.name for file in sorted(DEVICES.glob("renderD*"))] if DEVICES.is_dir() else []
    return graphics_found(os.environ, loaders, drivers, devices)


def graphics_found(
    environment: Mapping[str, str], loaders: list[str], drivers: list[str], devices: list[str]
) -> Finding:
    """Judge a display by environment variables, libraries that load drivers, Vulkan's drivers, and devices."""
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


UNSYNCHRONIZED = 5  # TIME_ERROR of adjtimex(2): nothing sets the clock
CLOCK_TOLERANCE_S = 86_400.0  # time by which the clock may be behind files that another machine may have dated [s]


def clock() -> Finding:
    """Examine whether the clock is set, and kept right."""
    ours = Path(guidefield.__file__).stat().st_mtime
    return clock_found(time.time(), ours, _system_state())


def clock_found(now: float, ours: float, state: int) -> Finding:
    """Judge a clock [s since 1970] by the time of guidefield's files and the state of `_system_state`."""
    date = datetime.datetime.fromtimestamp(now, datetime.UTC).isoformat(sep=" ", timespec="seconds")
    if now < ours - CLOCK_TOLERANCE_S:
        return wrong("clock", f"{date} is before guidefield was installed", "set it: `timedatectl set-time`, or NTP")
    if state == UNSYNCHRONIZED:
        return remark(
            "clock",
            f"{date}, kept right by nothing",
            "`timedatectl set-ntp true`, unless the host sets it: a clock that strays has certificates refused",
        )
    return fine("clock", date)


def _system_state() -> int:
    """Return the state of the clock by adjtimex(2), which changes nothing; negative if it isn't allowed or there."""
    asked = ctypes.create_string_buffer(256)  # struct timex, all 0: nothing is set
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)  # Linux's own
    return -1 if adjtimex is None else int(adjtimex(asked))


def examination(data: Path) -> Iterator[Finding]:
    """Yield the findings about this machine and a service's data folder."""
    checks: dict[str, Callable[[], Finding]] = {
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
    for about, check in checks.items():
        yield _examine(about, check)


def _examine(about: str, check: Callable[[], Finding]) -> Finding:
    try:
        return check()
    except OSError as error:
        return wrong(about, f"can't be looked at: {error}", "guidefield runs on Linux, with /proc readable")
