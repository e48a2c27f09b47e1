from __future__ import annotations

import numpy as np
import rerun as rr

from guidefield.memo import size_of
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


def test_kept_chunks_count_by_the_size_of_what_they_hold() -> None:
    points = np.zeros((10_000, 3), np.float32)
    chunk = still("/points", rr.Points3D(points))
    assert points.nbytes <= size_of((chunk,)) < 1.2 * points.nbytes
