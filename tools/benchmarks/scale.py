"""How the time of a whole answer grows: with obstacles, triangles, points, links, and waypoints of a given motion.

Usage: tools/bench scale [obstacles | triangles | points | movers | crossed | links | waypoints ...] [--most N]
       [--repeats N]

Each answer is through `guidefield.answer`, by CPU time of the process: the first one in a scene that was never seen,
and the best of the next ones. The exponent is that of the power of the size that fits best, over all sizes but the
smallest decade. Obstacles are small boxes, all but ten of them more than a metre away from where the robot is. Movers
are the same boxes, each of which slides to and fro; crossed are boxes at rest, with one that comes across the way.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

import guidefield
from benchmarks import grown
from benchmarks.grown import SEED, Made
from guidefield.messages import codec


class Subject(NamedTuple):
    """What grows: sizes, and the request of a size; another draw is another scene of the same kind."""

    sizes: tuple[int, ...]
    request: Callable[[int, int], Made]


def run(arguments: list[str]) -> None:
    """Print a table for each subject."""
    parser = argparse.ArgumentParser(prog="tools/bench scale", description=__doc__.partition("\n")[0])
    parser.add_argument("--most", type=int, default=1_000_000, help="leave larger sizes out")
    parser.add_argument("--repeats", type=int, default=3, help="answers after the first")
    parser.add_argument("subjects", nargs="*", choices=[*SUBJECTS, []], help="which; all unless told")
    asked = parser.parse_args(arguments)
    for warm in range(2):
        _answered(grown.plan(grown.boxes(5, warm)))
    for name in asked.subjects or SUBJECTS:
        subject = SUBJECTS[name]
        _table(name, subject, [size for size in subject.sizes if size <= asked.most], asked.repeats)


def _table(name: str, subject: Subject, sizes: Sequence[int], repeats: int) -> None:
    print(f"\n{name:>10} {'first, ms':>12} {'then, ms':>12}  status", flush=True)
    rows = []
    for draw, size in enumerate(sizes):
        request = codec.decode_request(subject.request(size, SEED + draw))
        first, status = _answered(request)
        then = min(_answered(request)[0] for _ in range(repeats))
        rows.append((size, first, then))
        print(f"{size:>10} {1e3 * first:>12.1f} {1e3 * then:>12.1f}  {status}", flush=True)
    fitted = [row for row in rows if row[0] >= 10 * sizes[0]] or rows
    if len(fitted) > 1:
        size, first, then = np.log(np.array(fitted)).T
        powers = [float(np.polyfit(size, times, 1)[0]) for times in (first, then)]
        print(f"{'exponent':>10} {powers[0]:>12.2f} {powers[1]:>12.2f}  from {fitted[0][0]} on", flush=True)


def _answered(request: Any) -> tuple[float, str]:
    """CPU time of an answer [s], and how it ended."""
    began = time.process_time()
    reply = guidefield.answer(request)
    return time.process_time() - began, reply.status.name


SUBJECTS = {
    "obstacles": Subject((10, 100, 1_000, 3_000, 10_000), lambda size, draw: grown.plan(grown.boxes(size, draw))),
    "triangles": Subject((1_000, 10_000, 100_000, 1_000_000), lambda size, draw: grown.plan(grown.terrain(size, draw))),
    "points": Subject((1_000, 10_000, 100_000, 1_000_000), lambda size, draw: grown.plan(grown.cloud(size, draw))),
    "movers": Subject((10, 100, 1_000, 2_000), lambda size, draw: grown.plan(grown.movers(size, draw))),
    "crossed": Subject((10, 100, 1_000, 10_000), lambda size, draw: grown.plan(grown.crossed(size, draw))),
    "links": Subject(tuple(grown.CHAINS), grown.chain),
    "waypoints": Subject((10, 100, 1_000, 10_000), grown.judged),
}
