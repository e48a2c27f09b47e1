"""How long it takes to answer about a large scene that was sent before, in each form that it can have.

Usage: tools/bench again [--boxes N] [--triangles N] [--repeats N]

A Panda's plan among boxes, and above a terrain of triangles, by CPU time of the process: the first answer about the
scene, and the best of the next ones. JSON and MessagePack are read as a worker of the service reads them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.grown import SEED, Made, boxes, plan, terrain
from guidefield.engine import Engine
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.stores.scenes import SceneStore

Ask = Callable[[Engine], Any]


def run(arguments: list[str]) -> None:
    """Print a line for each scene and form."""
    parser = argparse.ArgumentParser(prog="tools/bench again", description=__doc__.partition("\n")[0])
    parser.add_argument("--boxes", type=int, default=10_000)
    parser.add_argument("--triangles", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=5, help="answers after the first")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        engine = Engine(scenes=SceneStore(Path(folder)))
        for warm in range(2):
            engine.answer(plan(boxes(5, warm)))
        print(f"{'scene':>20} {'form':>24} {'first, ms':>10} {'then, ms':>10}", flush=True)
        for name, request in (
            (f"{asked.boxes} boxes", lambda: plan(boxes(asked.boxes, SEED))),
            (f"{asked.triangles} triangles", lambda: plan(terrain(asked.triangles, SEED))),
        ):
            for form, ask in _forms(request(), engine):
                first, *then = [_timed(ask, engine) for _ in range(1 + asked.repeats)]
                print(f"{name:>20} {form:>24} {1e3 * first:>10.1f} {1e3 * min(then):>10.1f}", flush=True)


def _forms(request: Made, engine: Engine) -> Iterator[tuple[str, Ask]]:
    """Each form of a request, by its name; a scene is another one in each."""
    yield from _written("lists", lambda name: _named(request, name))
    dicts = _named(request, "dict")
    yield "lists in a dict", lambda engine: engine.answer(dicts)
    message = codec.decode_request(_named(request, "message"))
    yield "message", lambda engine: engine.answer(message)
    if "triangles" in request["scene"]["obstacles"][0]:
        yield from _written("packed", lambda name: _with_arrays(_named(request, name), _packed))
        packed = _with_arrays(_named(request, "packed dict"), _packed)
        yield "packed in a dict", lambda engine: engine.answer(packed)
        arrays = _with_arrays(_named(request, "arrays"), lambda _, array: array)
        yield "arrays in a dict", lambda engine: engine.answer(arrays)
    stored = _named(request, "stored")
    engine.answer({"type": "store_scene", "name": "stored", "scene": stored["scene"]})
    by_name = {**request, "scene": "stored"}
    yield "stored", lambda engine: engine.answer(by_name)


def _written(form: str, made: Callable[[str], Made]) -> Iterator[tuple[str, Ask]]:
    for encoding in Encoding:
        payload = codec.encode(made(f"{form} {encoding.name}"), encoding)
        query = keys.Query(("plan",), {}, payload, encoding)
        yield f"{form}, {encoding.name}", lambda engine, query=query: engine.answer(keys.decode_query(query))


def _named(request: Made, name: str) -> Made:
    """A request whose scene has another name, and stands a little elsewhere, so that nothing of it was seen before."""
    scene, shift = request["scene"], 1e-6 * (1 + (sum(name.encode()) + time.time_ns()) % 100_000)
    first, *others = scene["obstacles"]
    moved = [x + shift for x in first.get("position", (0.0, 0.0, 0.0))]
    if "vertices" in first:
        first = {**first, "vertices": (np.asarray(first["vertices"]) + shift).tolist()}
    else:
        first = {**first, "position": moved}
    return {**request, "scene": {"name": name, "obstacles": [first, *others]}}


def _with_arrays(request: Made, put: Callable[[str, np.ndarray], Any]) -> Made:
    mesh = request["scene"]["obstacles"][0]
    arrays = {"vertices": np.array(mesh["vertices"], "<f4"), "triangles": np.array(mesh["triangles"], "<u4")}
    mesh = {**mesh, **{field: put(array.dtype.name, array) for field, array in arrays.items()}}
    return {**request, "scene": {**request["scene"], "obstacles": [mesh]}}


def _packed(kind: str, array: np.ndarray) -> Made:
    return {kind: array.tobytes()}


def _timed(ask: Ask, engine: Engine) -> float:
    """CPU time of an answer [s]."""
    began = time.process_time()
    reply = ask(engine)
    took = time.process_time() - began
    assert reply.certificate.collision_free, reply.status
    return took
