"""Proofs in a file: the cases that they are about, segments, slabs and convex shapes (referee.md)."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from guidefield.referee.loading import UnusableFile

FORMATS = ("guidefield proofs 2", "guidefield proofs 1")
"""Of the files that are read; the first is written, with cases of the same number."""

LARGEST = 2**31  # the largest proof that is read, unpacked [bytes]: a file of some MB could hold arrays of terabytes

WIDTHS = {"claims": 4, "segments": 2, "slab_nodes": 2, "slab_axes": 3, "views": 3, "origins": 3, "centres": 3}
WIDTHS |= {"node_children": 2, "node_shapes": 2, "shape_numbers": 5, "corners": 3}

LENGTHS = [("slab_segments", "slab_nodes", "slab_axes"), ("bodies", "numbers", "origins", "centres")]
LENGTHS += [("node_bodies", "node_children", "node_shapes")]


@dataclass(frozen=True, eq=False)
class Proof:
    """What a proof tells; nothing of it is believed."""

    # begin, end, 1 for own pairs and 0 for others, and a distance that they keep at least, which counts where it is
    # more than what is required, shape (c, 4) [s, s, -, m]
    claims: np.ndarray
    segments: np.ndarray  # begin and end of each, shape (s, 2) [s, or knots]
    slab_segments: np.ndarray  # the segment of each slab, shape (k,)
    slab_nodes: np.ndarray  # the two nodes that it is between, shape (k, 2)
    # its direction in the world, from the second to the first, shape (k, 3); where it is 0, that between the middles of
    # the spheres about both nodes, and these are meant
    slab_axes: np.ndarray
    joints: np.ndarray  # names of joints
    views: np.ndarray  # two bodies, and the joint that their motion is seen from, shape (p, 3)
    bodies: np.ndarray  # link, held object or obstacle of each body
    numbers: np.ndarray  # which of the bodies of that name it is, shape (b,)
    # from where its lengths are measured, shape (b, 3) [m]: in the shape's frame, of an obstacle where it is at first,
    # in the world
    origins: np.ndarray
    centres: np.ndarray  # middle of a sphere about it, from there, shape (b, 3) [m]
    node_bodies: np.ndarray  # the body of each node, shape (n,)
    node_children: np.ndarray  # the two nodes that it is divided into, -1 where it isn't, shape (n, 2)
    node_shapes: np.ndarray  # a sphere, and another shape, that hold all of it; -1 where none is reported, shape (n, 2)
    shape_begins: np.ndarray  # begin of each shape's corners, and the number of all, shape (h + 1,)
    # ball and disc that are added to their hull, and the disc's axis, shape (h, 5) [m]; a half-space has an infinite
    # ball, its offset and its normal
    shape_numbers: np.ndarray
    corners: np.ndarray  # shape (c, 3) [m]


NAMES = tuple(field.name for field in fields(Proof))


def is_proof(path: Path) -> bool:
    """Return whether a file begins as one of arrays does, which a proof is, a case not."""
    with path.open("rb") as file:
        return file.read(2) == b"PK"


def load_proofs(path: Path) -> list[tuple[dict[str, Any], Proof]]:
    """Read proofs, each with the case that it is about, as JSON has it.

    Raises:
        UnusableFile: if they can't be used, with what is wrong.
        OSError: if the file can't be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            size = sum(one.file_size for one in file.zip.infolist())
            if size > LARGEST:
                raise UnusableFile(f"{path.name} has {size} bytes unpacked, at most {LARGEST} are read")
            arrays = {name: file[name] for name in file.files}
        told, said = str(arrays.pop("format")), str(arrays.pop("digest"))
        if told not in FORMATS:
            raise UnusableFile(f"{path.name} must have `format` {FORMATS[0]!r}")
        if said != digest(arrays):
            raise UnusableFile(f"{path.name} has been changed: its digest is another one")
        first, *others = json.loads(arrays.pop("cases").tobytes())
        cases = [first, *(first | other for other in others)]
        proofs = [proof_of({name: arrays.pop(f"{k}/{name}") for name in NAMES}) for k in range(len(cases))]
        if arrays:
            raise UnusableFile(f"{path.name} has arrays of no case: {', '.join(sorted(arrays))}")
        return list(zip(cases, proofs, strict=True))
    except UnusableFile:
        raise
    except (
        KeyError,
        ValueError,
        TypeError,
        zlib.error,
        zipfile.BadZipFile,
        EOFError,
        MemoryError,
        RecursionError,
    ) as error:
        raise UnusableFile(f"{path.name} is no proof: {error}") from None


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256, in hexadecimal, of the names, types, shapes and bytes of arrays, in the order of their names."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape};".encode() + array.tobytes())
    return found.hexdigest()


def proof_of(arrays: dict[str, np.ndarray]) -> Proof:
    """The proof that arrays tell, of the shapes that `Proof` has, whose indices are within what there is.

    Raises:
        UnusableFile: if they aren't, or a number isn't finite.
    """
    p = Proof(**{name: arrays[name] for name in NAMES})
    for name, array in vars(p).items():
        if name in ("joints", "bodies"):
            continue
        if array.dtype.kind not in "if" or array.shape[1:] != ((WIDTHS[name],) if name in WIDTHS else ()):
            raise UnusableFile(f"`{name}` has another shape")
        if name != "shape_numbers" and not np.isfinite(array).all():
            raise UnusableFile(f"`{name}` must have finite numbers")
    nodes, shapes, child = len(p.node_bodies), len(p.shape_numbers), p.node_children
    divided = child[:, 0] >= 0
    if not _within(child[divided], nodes):
        raise UnusableFile("the proof contradicts itself (a node's child is none)")
    once = np.bincount(child[divided].ravel(), minlength=nodes) if divided.any() else np.zeros(nodes, int)
    counts = np.diff(p.shape_begins)[:shapes]
    balls = np.where(np.isinf(p.shape_numbers[:, 0]), 0.0, p.shape_numbers[:, 0])
    right = [
        *(len({len(getattr(p, name)) for name in names}) == 1 for names in LENGTHS),
        len(p.segments) > 0,
        len(p.shape_begins) == shapes + 1 and p.shape_begins[0] == 0 and p.shape_begins[-1] == len(p.corners),
        ((counts > 0) | ((counts == 0) & np.isinf(p.shape_numbers[: len(counts), 0]))).all(),
        np.isfinite(p.shape_numbers[:, 1:]).all() and (balls >= 0.0).all(),
        _within(p.slab_segments, len(p.segments)) and _within(p.slab_nodes, nodes),
        _within(p.views[:, :2], len(p.bodies)) and _within(p.views[:, 2], len(p.joints)),
        _within(p.node_bodies, len(p.bodies)) and _within(p.node_shapes + 1, shapes + 1),
        (divided == (child[:, 1] >= 0)).all() and (once <= 1).all(),
        (child[divided] > np.flatnonzero(divided)[:, None]).all(),
        (p.node_bodies[child[divided]] == p.node_bodies[divided, None]).all(),
        (p.segments[:, 0] <= p.segments[:, 1]).all(),
    ]
    if not all(right):
        raise UnusableFile(f"the proof contradicts itself ({right.index(False)})")
    return p


def _within(indices: np.ndarray, count: int) -> bool:
    return bool(indices.dtype.kind == "i" and ((indices >= 0) & (indices < count)).all())
