"""The motion of a run as arrays, and as a file for other programs: CSV, JSON or NumPy's NPZ.

Names of fields are those of the JSON and NPZ files; `guidefield certify` reads all three (`cli/certifying.py`).
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.execution import write_table
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply
from guidefield.whole_file import write_whole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RunArrays:
    """A run's motion; n knots of nq position and nv velocity coordinates [s, rad or m, per s, per s^2]."""

    run_id: str  # name of the run
    position_names: tuple[str, ...]  # one for each column of positions, nq
    velocity_names: tuple[str, ...]  # one for each column of velocities and accelerations, nv
    times: Array  # shape (n,)
    positions: Array  # shape (n, nq)
    velocities: Array  # shape (n, nv)
    accelerations: Array  # shape (n, nv)
    path: Array  # waypoints before time parameterization, shape (m, nq)


def run_arrays(run: PlanReply | Path | str) -> RunArrays:
    """Return the motion of a run, from its reply or its recording.

    Args:
        run: A reply, or the path of a recording (`.rrd`), made on any machine.

    Raises:
        UnknownObject: if there is no such file, or the run has no motion: it failed.
        MalformedRequest: if the file is no whole recording of guidefield, or the run judged a given motion.
    """
    reply: MotionReply
    if isinstance(run, PlanReply):
        reply = run
    else:
        from guidefield.recorder.stored import read_recording

        reply = read_recording(Path(run)).reply
    if isinstance(reply, CertifyReply):
        raise MalformedRequest(
            f"run {reply.run_id!r} judged a motion that was given: it stands in the request", run_id=reply.run_id
        )
    motion = reply.trajectory
    if motion is None:
        raise UnknownObject(f"run {reply.run_id!r} has no motion: {reply.status.name}", run_id=reply.run_id)
    return RunArrays(
        run_id=reply.run_id,
        position_names=tuple(reply.position_names),
        velocity_names=tuple(reply.velocity_names),
        times=_frozen(motion.times),
        positions=_frozen(motion.positions),
        velocities=_frozen(motion.velocities),
        accelerations=_frozen(motion.accelerations),
        path=_frozen(reply.path),
    )


def write_motion(motion: RunArrays, path: Path) -> None:
    """Write a motion, every number to its last digit, to a `.csv`, `.json` or `.npz` file; else MalformedRequest."""
    kinds = {".csv": _csv, ".json": _json, ".npz": _npz}
    if path.suffix not in kinds:
        controllers = "or, for a controller, .ros.json, .yaml or .script"
        raise MalformedRequest(f"{path.name!r} must end with one of {', '.join(kinds)}, {controllers}", path=str(path))
    write_whole(path, kinds[path.suffix](motion))


def _csv(motion: RunArrays) -> bytes:
    rates = [f"{kind}:{name}" for kind in ("velocity", "acceleration") for name in motion.velocity_names]
    head = ["time", *(f"position:{name}" for name in motion.position_names), *rates]
    columns = (motion.times[:, None], motion.positions, motion.velocities, motion.accelerations)
    return write_table(head, np.hstack(columns).tolist()).encode()


def _json(motion: RunArrays) -> bytes:
    return json.dumps(
        {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(motion).items()}
    ).encode()


def _npz(motion: RunArrays) -> bytes:
    file = io.BytesIO()
    arrays = {name: np.asarray(value) for name, value in vars(motion).items()}
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _frozen(rows: list[float] | list[list[float]]) -> Array:
    array = np.asarray(rows, dtype=np.float64)
    array.flags.writeable = False
    return array
