"""The graphics: a window of the viewer needs a display and a driver; nothing else does."""

from __future__ import annotations

import ctypes.util
import os
from collections.abc import Mapping
from pathlib import Path

from guidefield.doctor.finding import Finding, fine, remark

DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
DEVICES = Path("/dev/dri")
WEB = "`guidefield show --web` shows recordings in a browser; the service needs no graphics"


def graphics() -> Finding:
    """Whether the viewer can open a window."""
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
