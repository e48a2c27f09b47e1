"""A unit of work for tests of what runs units."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def two_plans(seed: int, _folder: Path) -> Any:
    """Two plans; the fifth unit fails."""
    from doubting.tally import Unit

    if seed == 5:
        return Unit(seed, 0.1, {"plans": 2, "disagreements": 1}, ["found/5.json"], "none")
    return Unit(seed, 0.1, {"plans": 2}, [], "none")
