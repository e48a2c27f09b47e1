"""The field: pairs of point and triangle a second, a robot among boxes, a large mesh, compile time."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.timing import best, multiply_add_peak
from guidefield.geometry import surfaces
from guidefield.geometry.charged import FieldTables, at_angle, field_tables, within
from guidefield.kernels.field.energy import energy, potentials
from guidefield.kernels.field.field import add_field, add_potential
from guidefield.kernels.field.field_tables import exact as exact_tables, single_precision
from guidefield.messages import scene as messages
from guidefield.potential import RobotField
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import Scene, build

REFERENCE = {
    ("indexed, triangles", "float64"): (2.2, 3.2), ("indexed, triangles", "float32"): (0.42, 0.9),
    ("indexed, slivers", "float64"): (2.2, 3.2), ("indexed, slivers", "float32"): (0.87, 1.34),
    ("sharing corners, quads", "float64"): (1.2, 2.2), ("sharing corners, quads", "float32"): (0.42, 0.9),
    ("boxes", "float64"): (1.2, 2.2), ("boxes", "float32"): (0.42, 0.9),
}  # fmt: skip
"""A prototype's figures for the like (robust in float64): potential, and potential with gradient [ns a pair]."""

REFERENCE_PEAK = {"float64": 122.0, "float32": 244.0}
"""Fused multiply-add peak of the core that they were measured on [GFLOP/s]."""

POINTS = 208


def run(arguments: list[str]) -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(prog="tools/bench field", description=__doc__)
    parser.add_argument("--compile", action="store_true", help="also how long the kernels take to compile")
    asked = parser.parse_args(arguments)
    peaks = {kind.__name__: multiply_add_peak(kind) for kind in (np.float64, np.float32)}
    for name, peak in peaks.items():
        print(f"FMA peak {name}: {peak:.0f} GFLOP/s, {peak / REFERENCE_PEAK[name]:.2f} of the reference core")
    _pairs(peaks)
    _robot()
    _large_mesh()
    if asked.compile:
        _compile_time()


def _pairs(peaks: dict[str, float]) -> None:
    print("\nns a point and triangle (pairs/s; times the reference, and that per FMA peak)")
    rng = np.random.default_rng(0)
    points = np.ascontiguousarray(rng.uniform(-1.0, 1.0, (3, POINTS)))
    boxes = _boxes(rng, 20)
    corners = np.concatenate([_faces(box)[0] for box in boxes])
    quads = np.concatenate([_faces(box)[1] for box in boxes])
    ball = surfaces.sphere(0.8, subdivisions=3)
    kinds = {
        "indexed, triangles": (field_tables(ball.corners), len(ball.triangles)),
        "indexed, slivers": (field_tables(ball.corners * [1.0, 1.0, 0.05]), len(ball.triangles)),
        "sharing corners, quads": (field_tables(quads=quads), len(corners)),
        "boxes": (field_tables(boxes=boxes), len(corners)),
    }
    for name, (tables, count) in kinds.items():
        for precision, of in (("float64", tables), ("float32", single_precision(tables, np.zeros(3)))):
            at = points.astype(of.boxes.dtype)
            field, potential = np.zeros((6, POINTS), at.dtype), np.zeros(POINTS, at.dtype)
            times = {"field": best(lambda of=of, at=at, out=field: add_field(of, at, 0, out))}
            if precision == "float32":
                times["potential"] = best(lambda of=of, at=at, out=potential: add_potential(of, at, 0, out))
            references = dict(zip(("potential", "field"), REFERENCE[name, precision], strict=True))
            per_peak = peaks[precision] / REFERENCE_PEAK[precision]
            shown = []
            for what, time in times.items():
                reference = references[what]
                ns = time / (POINTS * count) * 1e9
                shown.append(
                    f"{what} {ns:.2f} ({1e9 / ns:.2g}/s; {reference / ns:.2f}, {reference / ns / per_peak:.2f})"
                )
            print(f"  {name:24s} {precision}  " + "   ".join(shown))


def _boxes(rng: np.random.Generator, count: int) -> np.ndarray:
    rows = []
    for _ in range(count):
        rotation = np.asarray(pin.exp3(rng.normal(size=3)))
        rows.append(np.r_[rng.uniform(-1.2, 1.2, 3), rotation.T.ravel(), rng.uniform(0.05, 0.6, 3), 1.0])
    return np.array(rows)


def _faces(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and quads of a row of a box."""
    surface = surfaces.box(box[12:15])
    quads = np.array([(*surface.triangles[2 * k], surface.triangles[2 * k + 1][2]) for k in range(6)])
    vertices = surface.vertices @ box[3:12].reshape(3, 3) + box[:3]
    return vertices[surface.triangles], vertices[quads]


def _robot() -> None:
    """U and the generalised force of Panda among 20 boxes."""
    rng = np.random.default_rng(0)
    obstacles = []
    for k in range(20):
        out = rng.normal(size=3)
        position = out / np.linalg.norm(out) * rng.uniform(0.9, 1.5) + [0.0, 0.0, 0.4]
        turned = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
        size = tuple(rng.uniform(0.05, 0.5, 3))
        obstacles.append(messages.Box(name=f"b{k}", size=size, position=tuple(position), quaternion_xyzw=tuple(turned)))
    scene = build(messages.Scene(name="boxes", obstacles=obstacles))
    panda = Catalog().load("panda")
    print("\nPanda among 20 boxes, us a configuration (for 200 moving)")
    group = select(panda, None, None, panda.rest, pin.SE3.Identity())
    _robot_at(RobotField(group, scene), group.random(np.random.default_rng(1)), scene)


def _robot_at(field: RobotField, q: np.ndarray, scene: Scene) -> None:
    moving = int((field.charged.point_joints > 0).sum())
    print(f"  {len(field.charged.points)} points, {moving} of them moving, {len(field.charged.pairs)} repelling pairs")
    none = np.empty((0, 3), np.int64)
    none.setflags(write=False)
    alone = field.charged._replace(pairs=none)
    model = field.group.model
    outs = np.empty(model.nv), np.empty((model.nv, model.nv)), np.empty((model.njoints, 6))
    x, U = field.group.expand(q), np.empty(1)
    for name, tables in (("float64", scene.tables), ("float32", single_precision(scene.tables, np.zeros(3)))):
        asked = {"potential, gradient, metric, wrenches": lambda r, t=tables: energy(field.joints, r, t, x, *outs)}
        if name == "float32":
            asked["potential"] = lambda r, t=tables: potentials(field.joints, r, t, x[None], U)
        for what, ask in asked.items():
            without, own = (1e6 * best(lambda r=robot, ask=ask: ask(r)) for robot in (alone, field.charged))
            print(f"  {name}, {what}: {without:.0f} ({200 / moving * without:.0f})")
            print(f"    with self-repulsion {own:.0f} (+{own / without - 1:.0%})")


def _large_mesh() -> None:
    """A mesh of 81920 triangles, by the error that is allowed."""
    ball = surfaces.sphere(0.5, subdivisions=6)
    corners = ball.corners * (1.0 + 0.2 * np.sin(7.0 * ball.corners[..., :1]) * np.cos(5.0 * ball.corners[..., 1:2]))
    rng = np.random.default_rng(2)
    # A link of a robot: 20 points on a ball of 10 cm, somewhere around; and points spread at random.
    links = np.concatenate([_around(rng) + 0.1 * _unit(rng.normal(size=(20, 3))) for _ in range(12)])
    spread = 1.5 * _unit(rng.normal(size=(240, 3))) * rng.uniform(0.5, 1.0, (240, 1))
    print(f"\nMesh of {len(corners)} triangles, us a point with gradient: points of links; at random; error found")
    openings = {
        "angle 0.2": at_angle(0.2),
        "angle 0.23": at_angle(0.23),
        "bound 1e-2": within(1e-2),
        "bound 1e-3": within(1e-3),
    }
    for name, opening in openings.items():
        tables = field_tables(corners, opening=opening)
        figures = [_mesh_figures(tables, points) for points in (links, spread)]
        print(f"  {name}: {figures[0][0]:.2f}; {figures[1][0]:.2f}; {max(figure[1] for figure in figures):.1e}")


def _around(rng: np.random.Generator) -> np.ndarray:
    return _unit(rng.normal(size=3)) * rng.uniform(0.8, 1.3)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _mesh_figures(tables: FieldTables, points: np.ndarray) -> tuple[float, float]:
    """Time a point [us], largest relative error of the potential at some of them."""
    at = np.ascontiguousarray(points.T)
    out, exact = np.zeros((6, len(points))), np.zeros((6, 16))
    time = best(lambda: add_field(tables, at, 0, out), most=20) / len(points) * 1e6
    out[:] = 0.0
    add_field(tables, at, 0, out)
    add_field(exact_tables(tables), np.ascontiguousarray(at[:, :16]), 0, exact)
    return time, float(np.abs(out[0, :16] / exact[0] - 1.0).max())


def _compile_time() -> None:
    """In a process of its own with an empty cache: CPU time, which other work on the machine doesn't stretch."""
    script = "import time, guidefield.kernels.{}; print(time.process_time())"
    print("\nCompile time, CPU seconds with what each builds on")
    for module in ("field", "energy"):
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder))}
            command = [sys.executable, "-c", script.format(module)]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            print(f"  {module}: {float(done.stdout):.0f}")
