"""A case that was kept, answered and doubted again."""

from __future__ import annotations

import tempfile
from pathlib import Path

from doubting.case import Case
from doubting.doubted import doubted
from doubting.loaded import Loaded
from doubting.shrink import contradicted
from guidefield.engine import Engine


def repeated(file: Path) -> int:
    """Repeat a case, and tell of it: 0, or 1 if its answer is contradicted."""
    with tempfile.TemporaryDirectory() as folder:
        case = Case.read(file, Path(folder))
        print(f"{file}: {case.origin}")
        for said in case.said:
            print(f"  said then: {said}")
        loaded = Loaded.of(case.robot, Path(folder), Engine())
        came, found = doubted(loaded, case.request), contradicted(loaded, case.request)
    if came.reply is not None:
        print(f"  {came.reply.status.name}: {came.reply.status.message}")
    if came.sampled is not None:
        print(f"  sampled: {came.sampled.obstacle}, own {came.sampled.own}")
    for one in found:
        print(f"  said now: {one.kind}: {one.said}")
    return int(bool(found))
