"""Examine this machine: packages, clock, Zenoh on loopback and graphics, and whatever else a service needs."""

from __future__ import annotations

import ctypes
import ctypes.util
import datetime
import os
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import guidefield
from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.doctor.resources import cores, memory, vectors
from guidefield.doctor.storage import disk, kernels, runs
from guidefield.endpoint.link import DEFAULT_LISTEN, NoAnswer, is_taken, measure_answer


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
        yield _looked(about, look)


def _looked(about: str, look: Callable[[], Finding]) -> Finding:
    """What a look finds; that it can't look is a finding, too."""
    try:
        return look()
    except OSError as error:
        return wrong(about, f"can't be looked at: {error}", "guidefield runs on Linux, with /proc readable")
