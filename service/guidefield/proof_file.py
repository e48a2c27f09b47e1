"""A motion with its proof in one file: what the referee checks again (referee.md)."""

from __future__ import annotations

import hashlib
import io
import json
import lzma
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np

from guidefield.case_file import Motion, cases
from guidefield.prove.curve import Curve
from guidefield.prove.proof import Proof, prove
from guidefield.prove.search import Goal
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.spaces import ChartCurves
from guidefield.whole_file import write_whole

FORMAT = "guidefield proofs 1"

MOMENT = 1e-9
"""Time that a motion of one position takes [s]: the referee judges it for as long."""

SAMPLES = 33
"""Samples that the smallest distance along a motion is first looked for at."""


def write_proof(path: Path, motion: Motion) -> Verdict:
    """Prove a motion and write its proof to a file, where it is free; return the verdict.

    Raises:
        OSError: if it can't be written, or a mesh of the robot can't be read any more.
    """
    verdict, content = proof_of(motion)
    if content is not None:
        write_whole(path, content)
    return verdict


def proof_of(motion: Motion) -> tuple[Verdict, bytes | None]:
    """Prove a motion: the verdict, and its proof as the content of a file, None where it isn't free.

    Raises:
        OSError: if a mesh of the robot can't be read any more.
    """
    curve = curve_of(motion)
    span = float(curve.times[0]), float(curve.times[-1])
    found, proof = prove(
        motion.world, curve, Goal(motion.min_clearance, spans=[span], samples=np.linspace(*span, SAMPLES))
    )
    if proof is None:
        return found.verdict, None
    told = np.frombuffer(lzma.compress(json.dumps({"cases": cases(motion)}).encode(), preset=1), np.uint8)
    return found.verdict, packed({"cases": told, **arrays_of(proof)})


def arrays_of(proof: Proof) -> dict[str, np.ndarray]:
    """The arrays of a proof by their names, of the shapes that `Proof` tells."""
    return {field.name: getattr(proof, field.name) for field in fields(proof)}


def packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The content of a file of arrays of any shape, with a digest of them all."""
    content = io.BytesIO()
    named: dict[str, Any] = {"format": np.array(FORMAT), "digest": np.array(digest(arrays)), **arrays}
    np.savez_compressed(content, **named)
    return content.getvalue()


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256, in hexadecimal, of the names, types, shapes and bytes of arrays, in the order of their names."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape};".encode() + array.tobytes())
    return found.hexdigest()


def curve_of(motion: Motion) -> Curve:
    """The curve through a motion's knots: cubic between them where it has velocities, else straight."""
    p = motion.positions
    times = np.arange(float(len(p))) if motion.times is None else np.asarray(motion.times, float)
    if len(p) == 1:
        return Curve(cast(ChartCurves, np.repeat(p[None], 2, axis=1)), np.array([times[0], times[0] + MOMENT]))
    if motion.velocities is None:
        pieces = np.stack([p[:-1], p[1:]], axis=1)
    else:
        thirds = np.diff(times)[:, None] / 3.0
        v = motion.velocities
        pieces = np.stack([p[:-1], p[:-1] + thirds * v[:-1], p[1:] - thirds * v[1:], p[1:]], axis=1)
    return Curve(cast(ChartCurves, pieces), times)
