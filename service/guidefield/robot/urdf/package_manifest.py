"""The manifest of a ROS package, `package.xml`."""

from __future__ import annotations

import re
from pathlib import Path

MANIFEST = "package.xml"
MAX_BYTES = 1 << 20
"""No manifest is larger."""


def package_name(manifest: Path) -> str | None:
    """Return the name that a manifest declares; None if it has none or can't be read."""
    try:
        with manifest.open("rb") as file:
            text = file.read(MAX_BYTES).decode(errors="replace")
    except OSError:
        return None
    found = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    return found.group(1) if found else None
