from __future__ import annotations

import numpy as np
import rerun as rr

from guidefield.recorder.chunks import path_times, shown, still, timed


def curve(path: str, rows: int) -> list[object]:
    values = np.arange(rows, dtype=float)
    return [
        still(path, rr.SeriesLines(names=["a"])),
        timed(path, [path_times(values)], rr.Scalars.columns(scalars=values)),
    ]


def test_a_curve_of_one_point_shows_nothing():
    words = still("/documents/summary", rr.TextDocument("so it was"))
    chunks = [words, *curve("/plots/position", 1), *curve("/plots/clearance", 2)]
    assert shown(chunks) == {"/documents/summary", "/plots/clearance"}
