"""Prove motions and write them with their proofs to one file, which the referee checks (service/docs/referee.md).

Arrays are named "k/field": k is a motion's number, fields are those of `referee/proof.py` `Proof`, which reads them.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from guidefield.case_file import Motion, count_items, make_cases
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.prove.curve import Curve
from guidefield.prove.proof import Proof, prove
from guidefield.prove.search import Goal
from guidefield.prove.verdict import Reason
from guidefield.referee.proof import FORMATS, digest
from guidefield.whole_file import write_whole

MOMENT = 1e-9  # time that a motion of one position takes [s], as in `referee/loading.py`
SAMPLES = 33  # samples with which the search for the smallest distance along a motion begins
WRITING_S_PER_ITEM = 1.2e-5
"""Longest time to write an obstacle, triangle, point or knot [s]; measured: 11 us a box of 100,000, 2 us a triangle or
point of a million."""


class UnprovedError(Exception):
    """A motion has no proof, in words."""


def write_proof(path: Path, *motions: Motion) -> None:
    """Prove motions and write their proofs to a file.

    Raises:
        UnprovedError: if one isn't free.
        OSError: if it can't be written, or a mesh of the robot can't be read any more.
    """
    write_whole(path, proof_of(motions))


def proof_of(motions: Sequence[Motion], deadline: Deadline = UNLIMITED) -> bytes:
    """Prove motions; return the proofs as the content of a file.

    Nothing can interrupt the writing: where it would outlast the deadline, it isn't begun; raises UnprovedError if one
    isn't free, or the deadline is too early; raises OSError if a mesh of the robot can't be read any more.
    """
    writing, arrays = WRITING_S_PER_ITEM * sum(map(count_items, motions)), dict[str, np.ndarray]()
    for k, part in enumerate(motions):
        curve = curve_of(part)
        found, proof = prove(part.world, curve, _goal_of(part, curve), deadline)
        if found.verdict.reason is Reason.STOPPED or deadline.expired():
            raise UnprovedError("time was up before it was written down")
        if deadline.remaining() < writing:
            raise UnprovedError(f"to write it down takes about {writing:.2g} s, and time would be up before that")
        if proof is None:
            pair = "" if found.verdict.pair is None else f": {' and '.join(found.verdict.pair)}"
            raise UnprovedError(f"the motion isn't free{pair}")
        arrays |= {f"{k}/{name}": array for name, array in arrays_of(proof).items()}
    cases = make_cases(*motions)
    for one in cases[1:]:  # the referee takes a field that is left out from the first case
        for name in [name for name, value in one.items() if value == cases[0][name]]:
            del one[name]
    arrays["cases"] = np.frombuffer(msgspec.json.encode(cases), np.uint8)
    return pack_arrays(arrays)


def _goal_of(part: Motion, curve: Curve) -> Goal:
    """Return the goal of a proof's search: smallest distances, too, unless the robot may be beside the curve."""
    if curve.tube is not None:
        return Goal(part.min_clearance)
    span = float(curve.times[0]), float(curve.times[-1])
    return Goal(part.min_clearance, spans=[span], samples=np.linspace(*span, SAMPLES))


def arrays_of(proof: Proof) -> dict[str, np.ndarray]:
    """Return the arrays of a proof by their names, of the shapes that `Proof` tells."""
    return {field.name: getattr(proof, field.name) for field in fields(proof)}


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return the content of a proof file: arrays of any shape, its format and a digest of them all."""
    content = io.BytesIO()
    named: dict[str, Any] = {"format": np.array(FORMATS[0]), "digest": np.array(digest(arrays)), **arrays}
    np.savez_compressed(content, **named)
    return content.getvalue()


def curve_of(motion: Motion) -> Curve:
    """Return the curve through a motion's knots, with the tube about it that the robot may be in."""
    count = len(motion.positions)
    times = np.arange(float(count)) if motion.times is None else np.asarray(motion.times, float)
    rates = motion.velocities, motion.accelerations
    drawn = GivenMotion.through(times, motion.positions, *rates, motion.tolerance, steps=motion.steps)
    return Curve(drawn.pieces, np.append(times, times[0] + MOMENT) if count == 1 else times, drawn.tube)
