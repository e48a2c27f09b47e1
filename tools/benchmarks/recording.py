"""What a recording costs: how much slower planning is, how long writing takes, how large a run becomes.

Options: [--repeats N] [request.json ..]; without requests the demonstration's and some of tools/examples/requests. Each
is planned in turns with `recording` off, summary and full, the first round not counted; times are of the processor, the
least of all rounds: of planning without the writing, and of the writing itself. Sizes are of a run's recording in a
store, and of the file that leaves the store, both without the robot's meshes.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import msgspec

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
        shutil.rmtree(Path(folder) / "runs-robots")  # what leaves the store does so without meshes then
        print(f"{name:18s} planning {1e3 * base:7.1f} ms", end="")
        for level in LEVELS[1:]:
            run_id = f"{level}-{repeats}"
            stored, left = recordings.path(run_id).stat().st_size, len(whole_recording(recordings, run_id))
            slower, writing = 100.0 * (min(spent[level]) / base - 1.0), 1e3 * min(written[level])
            print(f" | {level}: {slower:+5.1f} %, writing {writing:5.1f} ms, {stored / 1e3:4.0f} kB stored,", end="")
            print(f" {left / 1e3:4.0f} kB outside", end="")
        print(flush=True)


def run(arguments: list[str]) -> None:
    """Measure and print a line for each request."""
    Recorder.finish = timed_finish  # type: ignore[method-assign]
    parser = argparse.ArgumentParser(prog="tools/bench recording", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("requests", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    files = options.requests or [EXAMPLES / f"{name}.json" for name in CHOSEN]
    if not options.requests:
        for name, (_, request) in REQUESTS.items():
            measure(name, request, options.repeats)
    for file in files:
        measure(file.stem, codec.decode(file.read_bytes(), PlanRequest), options.repeats)
