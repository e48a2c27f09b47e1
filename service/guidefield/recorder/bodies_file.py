"""Robots ready to be drawn, on disk: a robot's meshes are read and turned into chunks once, not once per process.

A file is named by what it was made from. It holds the meshes as a recording shows them, and the sketch for ghosts.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import rerun as rr
from lxml import etree
from rerun.chunk import Chunk

from guidefield.errors import strip_path
from guidefield.geometry import cache
from guidefield.memo import MISSING, Answers
from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import RobotBodies, mesh
from guidefield.recorder.chunks import entity, still
from guidefield.recorder.rrd_file import UNREADABLE, encode_recording, read_chunks, read_meshes
from guidefield.recorder.surface import Surface
from guidefield.robot.mesh_files import reading as mesh_files
from guidefield.robot.model.model import RobotModel
from guidefield.whole_file import DRAFT, write_whole

MOST_FILES = 64
"""Robots kept prepared in a folder; recordings of a robot that was dropped leave the store without its meshes."""

ABANDONED = 3600.0
"""Age from which a file that was never finished won't be [s]."""

NAMES = "/prepared"
"""The entity that tells what a file holds."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """The parts of a drawn robot that a recording needs beside its meshes.

    Attributes:
        file: Where the meshes are.
        links: Links that carry something.
        sketch: Per link the thinned-out hulls of its collision geometry, in the link's frame.
        faults: What can't be drawn, or kept.
    """

    file: Path
    links: tuple[str, ...]
    sketch: tuple[tuple[str, Surface], ...]
    faults: tuple[str, ...]


def cache_folder() -> Path:
    """The folder of prepared robots for runs without a store, beside the geometry's cache."""
    return cache.folder().with_name("drawn")


def prepared(robot: RobotModel, folder: Path) -> Drawn:
    """A robot ready to be drawn, from its file; that is made if it isn't there, and a disk that refuses is a fault.

    Args:
        robot: The robot.
        folder: Where such files are; made if it isn't there.
    """
    drawn = _PREPARED.of(robot, folder)
    if drawn is MISSING or not (drawn.faults or drawn.file.exists()):  # somebody may have cleared the folder away
        _PREPARED.forget(robot, folder)
        drawn = _PREPARED.keep(robot, folder, _prepare(robot, folder))
    return drawn


def meshes(robot: RobotModel, drawn: Drawn) -> list[Chunk]:
    """A robot's meshes, as `bodies.prepare` makes them; from its file if that is whole."""
    try:
        return read_meshes(drawn.file)
    except UNREADABLE:
        return list(bodies.prepare(robot).chunks)


_PREPARED = Answers[Drawn]()


def _prepare(robot: RobotModel, folder: Path) -> Drawn:
    file = folder / f"{_fingerprint(robot)}.rrd"
    try:
        known = _read(file)
    except UNREADABLE:
        made = bodies.prepare(robot)
    else:
        with contextlib.suppress(OSError):
            os.utime(file)  # it is in use: others are dropped before it
        return known
    drawn = Drawn(file, made.links, made.sketch, made.faults)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, encode_recording(file.stem, [*made.chunks, *_sketch_chunks(made)], None), durable=False)
    except OSError as error:
        return replace(drawn, faults=(*drawn.faults, f"the robot's meshes could not be kept: {strip_path(error)}"))
    with contextlib.suppress(OSError):  # another process may make room too
        _make_room(folder)
    return drawn


def _make_room(folder: Path) -> None:
    """Drop the robots that were used longest ago, if there are too many, and what writers that were killed left."""
    files = sorted(folder.glob("*.rrd"), key=lambda file: file.stat().st_mtime, reverse=True)
    for old in files[MOST_FILES:]:
        old.unlink(missing_ok=True)
    for draft in folder.glob(f".*{DRAFT}"):
        if time.time() - draft.stat().st_mtime > ABANDONED:
            draft.unlink(missing_ok=True)


def _fingerprint(robot: RobotModel) -> str:
    """A hash of all that a robot's pictures are made from: its text, its mesh files, its cover, who reads them."""
    source = robot.source.urdf_text.encode()
    digest = hashlib.sha256(f"{rr.__version__} {version('trimesh')} {bodies.known(robot)} ".encode() + source)
    for module in (__file__, bodies.__file__, mesh_files.__file__, surface.__file__):
        digest.update(Path(module).read_bytes())
    for element in etree.fromstring(source).iter("mesh"):
        path = Path(element.get("filename"))
        if path.exists():
            state = path.stat()
            digest.update(f"{path} {state.st_size} {state.st_mtime_ns}".encode())
    return digest.hexdigest()[:32]


def _sketch_chunks(made: RobotBodies) -> list[Chunk]:
    """The sketch, and the names that go with it."""
    sketched = [still(entity("sketch", f"{number}"), mesh(one)) for number, (_, one) in enumerate(made.sketch)]
    names = {"links": list(made.links), "sketched": [link for link, _ in made.sketch], "faults": list(made.faults)}
    told = still(NAMES, rr.AnyValues(**{name: [one or "" for one in values] or [""] for name, values in names.items()}))
    return [*sketched, told]


def _read(file: Path) -> Drawn:
    """Read the file that `_prepared` wrote.

    Raises:
        OSError, ValueError, KeyError, RuntimeError: if there is no such file, or it isn't whole.
    """
    chunks = {chunk.entity_path: chunk for chunk in read_chunks(file)}
    told = chunks[NAMES].to_record_batch()
    links, sketched, faults = (
        tuple(filter(None, told.column(name).to_pylist()[0])) for name in ("links", "sketched", "faults")
    )
    sketch = tuple((link, _surface(chunks[entity("sketch", f"{number}")])) for number, link in enumerate(sketched))
    return Drawn(file, links, sketch, faults)


def _surface(chunk: Chunk) -> Surface:
    batch = chunk.to_record_batch()
    vertices, triangles, normals = (
        batch.column(f"Mesh3D:{name}").flatten().flatten().to_numpy().reshape(-1, 3)
        for name in ("vertex_positions", "triangle_indices", "vertex_normals")
    )
    return Surface(vertices, triangles, normals)
