"""The cost of recordings: of some plans, and of how it grows with the scene, the steps and the robot.

Usage: tools/bench recording [boxes | triangles | points | polygons | movers | steps | links | request.json ...]
       [--repeats N] [--small]

Without arguments: the demonstration's requests, some of tools/examples/requests, and everything that grows, at n and
16 n (links at 6 and 48). All times are CPU times of the process, the least of all rounds.

For a request, plans with `recording` off, summary and full take turns, the first round not counted: the time of
planning without writing, and of writing. What grows is planned in a scene that was never seen, and again: *first* and
*then* are the times of writing. Sizes are of a run's recording in a store, and of the file that leaves the store; the
robot's meshes are in neither.
"""

from __future__ import annotations

import argparse
import logging
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from benchmarks import grown
from benchmarks.grown import SEED, Made
from guidefield.demo import REQUESTS
from guidefield.engine import Engine
from guidefield.messages import codec
from guidefield.messages.requests import PlanRequest
from guidefield.recorder.recorder import Recorder
from guidefield.run import whole_recording
from guidefield.stores.recordings import Recordings

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "requests"
CHOSEN = ("door", "seed_a_gates", "seed_b_tapered")
LEVELS = ("off", "summary", "full")

SUBJECTS: dict[str, tuple[tuple[int, int], Callable[[int, int], Made]]] = {
    "boxes": ((256, 4096), lambda size, draw: grown.plan(grown.boxes(size, draw))),
    "triangles": ((5_120, 81_920), lambda size, draw: grown.plan(grown.terrain(size, draw))),
    "points": ((18_750, 300_000), lambda size, draw: grown.plan(grown.cloud(size, draw))),
    "polygons": ((128, 2048), lambda size, draw: grown.plan(grown.polygons(size, draw))),
    "movers": ((4, 64), lambda size, draw: grown.plan(grown.movers(size, draw))),
    "steps": ((6, 96), grown.steps),
    "links": ((6, 48), grown.chain),
}
"""Sizes, and the request of a size; another draw is another scene of the same kind."""

_finish, _written = Recorder.finish, [0.0]
"""How a recording is written, and how long that took last by the processor [s]."""


def timed_finish(recorder: Recorder, *about: Any) -> None:
    """Write a recording and see how long it takes."""
    began = time.process_time()
    _finish(recorder, *about)
    _written[0] += time.process_time() - began


def measure(name: str, request: PlanRequest, repeats: int) -> None:
    """Print a line about a request."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Recordings(Path(folder) / "recordings")
        engine, spent, written = Engine(recordings=recordings), defaultdict(list), defaultdict(list)
        for turn in range(repeats + 1):
            for level in LEVELS:
                _written[0], began = 0.0, time.process_time()
                engine.answer(msgspec.structs.replace(request, recording=level, run_id=f"{level}-{turn}"))
                if turn:
                    spent[level].append(time.process_time() - began - _written[0])
                    written[level].append(_written[0])
        base = min(spent["off"])
        shutil.rmtree(recordings.bodies_folder)  # what leaves the store does so without meshes then
        print(f"{name:18s} planning {1e3 * base:7.1f} ms", end="")
        for level in LEVELS[1:]:
            stored, left = sizes(recordings, f"{level}-{repeats}")
            slower, writing = 100.0 * (min(spent[level]) / base - 1.0), 1e3 * min(written[level])
            print(f" | {level}: {slower:+5.1f} %, writing {writing:5.1f} ms, {stored:6.0f} kB stored,", end="")
            print(f" {left:6.0f} kB outside", end="")
        print(flush=True)


def measure_growth(name: str, size: int, requests: Sequence[PlanRequest], repeats: int) -> None:
    """Print a line about a size of what grows; the first request prepares the robot."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Recordings(Path(folder) / "recordings")
        engine, written = Engine(recordings=recordings), []
        for turn, request in enumerate([requests[0], *[requests[1]] * (repeats + 1)]):
            _written[0] = 0.0
            reply = engine.answer(msgspec.structs.replace(request, recording="full", run_id=f"{turn}"))
            written.append(1e3 * _written[0])
        shutil.rmtree(recordings.bodies_folder)
        stored, left = sizes(recordings, f"{repeats + 1}")
        print(f"{name:>10}{size:>9} {written[1]:>10.1f}{min(written[2:]):>10.1f}", end="")
        print(f"{stored:>10.0f}{left:>10.0f}  {reply.status.name}", flush=True)


def sizes(recordings: Recordings, run_id: str) -> tuple[float, float]:
    """The size of a run's recording in the store, and of the file that leaves it [kB]."""
    stored = recordings.path(run_id).stat().st_size
    return 1e-3 * stored, 1e-3 * len(whole_recording(recordings, run_id))


def run(arguments: list[str]) -> None:
    """Measure and print a line for each request, and each size of what grows."""
    Recorder.finish = timed_finish  # type: ignore[method-assign]
    logging.getLogger("guidefield.recorder").setLevel(logging.ERROR)  # it warns of meshes that are missing
    parser = argparse.ArgumentParser(prog="tools/bench recording", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--small", action="store_true", help="leave the larger sizes out")
    parser.add_argument("what", nargs="*", help="what grows, and files of requests; all unless told")
    options = parser.parse_args(arguments)
    files = [Path(what) for what in options.what if what not in SUBJECTS]
    subjects = [what for what in options.what if what in SUBJECTS]
    if not options.what:
        files, subjects = [EXAMPLES / f"{name}.json" for name in CHOSEN], list(SUBJECTS)
        for name, (_, request) in REQUESTS.items():
            measure(name, request, options.repeats)
    for file in files:
        measure(file.stem, codec.decode(file.read_bytes(), PlanRequest), options.repeats)
    if subjects:
        print(f"\n{'':>19} {'first, ms':>10}{'then, ms':>10}{'kept, kB':>10}{'whole, kB':>10}", flush=True)
    for subject in subjects:
        grown_sizes, made = SUBJECTS[subject]
        for size in grown_sizes[: 1 if options.small else None]:
            requests = [codec.convert(made(size, draw), PlanRequest) for draw in (SEED + 1, SEED)]
            measure_growth(subject, size, requests, max(1, options.repeats))
