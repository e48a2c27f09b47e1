"""The cost of recordings: of some plans, and of how it grows with the scene, the steps and the robot.

Usage: tools/bench recording [boxes | triangles | points | polygons | movers | steps | links | request.json ...]
       [--repeats N] [--small]

Without arguments: the demonstration's requests, some of tools/examples/requests, and everything that grows, at n and
16 n (links at 6 and 48). All times are CPU times of the process, the least of all rounds.

For a request, plans with `recording` off, summary and full take turns, the first round not counted: the time of
planning, what the log adds to it, and the time of rendering. What grows is planned in a scene that was never seen, and
again: *first* and *then* are the times of rendering. Sizes are of a run's recording in a store, and of the file that
leaves the store; the robot's meshes are in neither.
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

import msgspec

from benchmarks import grown
from benchmarks.grown import SEED, Made
from guidefield.cli.demonstration import REQUESTS
from guidefield.engine import Engine
from guidefield.messages import codec
from guidefield.messages.requests import PlanRequest
from guidefield.rendering import Renderings
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


def rendering_time(renderings: Renderings, recordings: Recordings, run_id: str) -> float:
    """Render a recording; the time that it takes [s]."""
    began = time.process_time()
    renderings.render(recordings, run_id)
    return time.process_time() - began


def measure(name: str, request: PlanRequest, repeats: int) -> None:
    """Print a line about a request."""
    with tempfile.TemporaryDirectory() as folder:
        recordings, renderings = Recordings(Path(folder) / "recordings"), Renderings()
        engine, spent, rendered = Engine(recordings=recordings), defaultdict(list), defaultdict(list)
        for turn in range(repeats + 1):
            for level in LEVELS:
                run_id, began = f"{level}-{turn}", time.process_time()
                engine.answer(msgspec.structs.replace(request, recording=level, run_id=run_id))
                answered = time.process_time() - began
                seconds = 0.0 if level == "off" else rendering_time(renderings, recordings, run_id)
                if turn:
                    spent[level].append(answered)
                    rendered[level].append(seconds)
        base = min(spent["off"])
        shutil.rmtree(recordings.bodies_folder)  # what leaves the store does so without meshes then
        print(f"{name:18s} planning {1e3 * base:7.1f} ms", end="")
        for level in LEVELS[1:]:
            stored, left = sizes(recordings, f"{level}-{repeats}")
            logged, rendering = 1e3 * (min(spent[level]) - base), 1e3 * min(rendered[level])
            print(f" | {level}: {logged:+5.2f} ms, rendering {rendering:5.1f} ms, {stored:6.0f} kB stored,", end="")
            print(f" {left:6.0f} kB outside", end="")
        print(flush=True)


def measure_growth(name: str, size: int, requests: Sequence[PlanRequest], repeats: int) -> None:
    """Print a line about a size of what grows; the first request prepares the robot."""
    with tempfile.TemporaryDirectory() as folder:
        recordings, renderings = Recordings(Path(folder) / "recordings"), Renderings()
        engine, rendered = Engine(recordings=recordings), []
        for turn, request in enumerate([requests[0], *[requests[1]] * (repeats + 1)]):
            reply = engine.answer(msgspec.structs.replace(request, recording="full", run_id=f"{turn}"))
            rendered.append(1e3 * rendering_time(renderings, recordings, f"{turn}"))
        shutil.rmtree(recordings.bodies_folder)
        stored, left = sizes(recordings, f"{repeats + 1}")
        print(f"{name:>10}{size:>9} {rendered[1]:>10.1f}{min(rendered[2:]):>10.1f}", end="")
        print(f"{stored:>10.0f}{left:>10.0f}  {reply.status.name}", flush=True)


def sizes(recordings: Recordings, run_id: str) -> tuple[float, float]:
    """The size of a run's recording in the store, and of the file that leaves it [kB]."""
    stored = recordings.path(run_id).stat().st_size
    return 1e-3 * stored, 1e-3 * len(whole_recording(recordings, run_id))


def run(arguments: list[str]) -> None:
    """Measure and print a line for each request, and each size of what grows."""
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
