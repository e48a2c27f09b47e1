"""Bounding and inscribed spheres and convex parts of a robot's links: one search for each shape, kept on disk.

SIMD batches test spheres and parts before the exact shapes (`collision/batch/robot_tables.py`). They may be coarser,
but have to contain the shapes, and inscribed spheres to lie inside: `DELTA`, `LARGE`, `SMALL`, `TIGHT` and `MOST_PARTS`
trade the time of the first use, and of every plan, against each other; streams' paths keep their distances from the
spheres. A change in this file makes what is on disk anew.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar, cast

import coal
import numpy as np

from guidefield.geometry.cache import Arrays, entry_name, find_or_compute, recall
from guidefield.geometry.cover import LEAST_REACHES, Cover, cover
from guidefield.geometry.decomposition import ConvexPart, Decomposition, decompose
from guidefield.geometry.primitive_covers import (
    cover_box,
    cover_capsule,
    cover_cylinder,
    cover_sphere,
    inner_balls,
    inner_box,
    inner_capsule,
    inner_cylinder,
    inner_sphere,
)
from guidefield.geometry.solid import fill_hollows, fill_solid_of_mesh, near_solid_of_mesh, solid_of_mesh
from guidefield.geometry.surfaces import Floats, Surface
from guidefield.kernels.jit.decorators import load_imported
from guidefield.memo import MISSING, Answers, memoized
from guidefield.parallel import run_queue, usable_processors
from guidefield.robot.model.collision_shapes import WIDEST_GAP, triangulation
from guidefield.robot.model.model import RobotModel, power_of_two, scale

_log = logging.getLogger(__name__)

Found = TypeVar("Found")

Question = tuple[str, Arrays, Callable[[], Arrays]]
"""A search for a shape as `cache.find_or_compute` takes it: a kind, inputs, and a function that computes the result."""


class ShapeTask(NamedTuple):
    """Work on a collision shape, and on all that are equal to it."""

    description: str  # in words: ``covering link2, shape 3 of 8``
    extent: float  # of the shape [m], or in its unit: the largest takes longest
    find: Callable[[], object]

    @classmethod
    def of(cls, doing: str, robot: RobotModel, index: int, extent: float, find: Callable[[], object]) -> ShapeTask:
        """Make the task of a robot's collision shape."""
        shapes = robot.geometry.geometryObjects
        link = robot.model.frames[shapes[index].parentFrame].name
        return cls(f"{doing} {link}, shape {index + 1} of {len(shapes)}", extent, find)


Progress = Callable[[ShapeTask], None]  # called before each task is begun, by one thread at a time


def log_task(task: ShapeTask) -> None:
    """Log what is done."""
    _log.info("%s", task.description)


def find_in_parallel(tasks: Sequence[ShapeTask], progress: Progress, threads: int | None = None) -> None:
    """Do tasks in their order on all processors; kernels are loaded before, as threads must not load them.

    Args:
        progress: If it raises, no more tasks are begun, and its exception is raised.
        threads: How many; 1 where results are probably on disk, because loading all kernels takes longer than reading.
    """
    threads = min(threads or usable_processors(), len(tasks))
    if threads > 1:
        load_imported("cover.", "distance.", "linalg.")

    def begin_each() -> Iterator[Callable[[], object]]:
        for task in tasks:
            progress(task)
            yield task.find

    run_queue(begin_each(), max(threads, 1))


class ByShape(Generic[Found]):
    """A search for each shape of a robot, whose results are kept with the robot.

    Args:
        doing: A word for the search.
        question: Makes the search for a Coal shape, of the further argument and the unit of lengths [m]; None for a
            shape that nothing is found for.
        restored: Makes a result in metres from its arrays and that unit.
    """

    def __init__(
        self,
        doing: str,
        question: Callable[[Any, Any, float], Question | None],
        restored: Callable[[Arrays, float], Found | None],
    ) -> None:
        self._doing, self._question, self._restored = doing, question, restored
        self._known = Answers[tuple[Found | None, ...]]()

    def all(self, robot: RobotModel, argument: Hashable, progress: Progress) -> tuple[Found | None, ...]:
        """Find a result for each shape, in the geometry's order; exceptions of `progress` are raised."""
        search = self.search(robot, argument)
        find_in_parallel(search.tasks, progress)
        return search.keep()

    def recall(self, robot: RobotModel, argument: Hashable) -> tuple[Found | None, ...]:
        """Return the results that are in memory or on disk; None for the others."""
        return self.search(robot, argument).found()

    def search(self, robot: RobotModel, argument: Hashable) -> ShapeSearch[Found]:
        """Return the results that are known, and tasks for the others, the largest shape first."""
        known, unit = self._known.of(robot, argument), power_of_two(robot.size)
        if known is not MISSING:
            return ShapeSearch([], lambda: known, lambda: known)
        names: list[str | None] = []
        answers: dict[str, Found | None] = {}
        tasks: dict[str, ShapeTask] = {}

        def find(name: str, question: Question) -> None:
            answers[name] = self._restored(find_or_compute(*question), unit)

        def collect() -> tuple[Found | None, ...]:
            return tuple(None if name is None else answers.get(name) for name in names)

        for index, shape in enumerate(robot.geometry.geometryObjects):
            question = self._question(shape.geometry, argument, unit)
            names.append(None if question is None else entry_name(*question))
            name = names[-1]
            if question is None or name is None or name in answers or name in tasks:
                continue
            arrays, inputs = recall(*question), question[1]
            if arrays is not None:
                answers[name] = self._restored(arrays, unit)
                continue
            extent = max(float(np.max(array)) for array in inputs.values())
            if "vertices" in inputs:
                extent = float(np.linalg.norm(np.ptp(inputs["vertices"], axis=0)))
            work = functools.partial(find, name, question)
            tasks[name] = ShapeTask.of(self._doing, robot, index, extent, work)
        largest_first = sorted(tasks.values(), key=lambda task: -task.extent)
        return ShapeSearch(largest_first, collect, lambda: self._known.keep(robot, argument, collect()))


class ShapeSearch(NamedTuple, Generic[Found]):
    """Results about a robot's shapes, in the geometry's order."""

    tasks: list[ShapeTask]  # work that finds those that aren't known
    found: Callable[[], tuple[Found | None, ...]]  # returns those that are known by now, None elsewhere
    keep: Callable[[], tuple[Found | None, ...]]  # returns them once all are found, and keeps them with the robot


DELTA = 0.015  # by how much covers may leave the shapes, unless stated otherwise [m], at size 1

LARGE = 3_000.0
"""A surface of more than LARGE delta^2 gets a cover that may leave it further, by sqrt(area / LARGE).

So the tolerance follows the size of a link: it is `DELTA` up to 0.67 m^2, and a link takes about half a second at most.
With 1500 plans for Baxter took a twentieth longer.
"""


SMALL = 2.0
"""Covers of robots smaller than usual (`size`) may leave the shapes by this factor more, relative to their size.

Their links are as intricate: the first use of an SO-101 takes a tenth less so. Plans of a Panda of 0.35 and 0.1 times
the size are as long and take as long.
"""


@dataclass(frozen=True, eq=False)
class ShapeCoverage:
    """Bounding and inscribed balls of a collision shape in its tested form, in its own frame."""

    cover: Cover
    inner: Floats  # shape (n, 4) [m]


@dataclass(frozen=True, eq=False)
class Coverage:
    """Balls of every shape of a robot, in the geometry's order."""

    shapes: tuple[ShapeCoverage, ...]
    # by how much the covers may leave the shapes, at size 1 [m]; those of `LARGE` ones and of small robots may leave
    # them further
    delta: float

    @property
    def spheres(self) -> int:
        """How many spheres contain the robot."""
        return sum(len(shape.cover.spheres) for shape in self.shapes)

    @property
    def inner(self) -> int:
        """How many balls are inside of it."""
        return sum(len(shape.inner) for shape in self.shapes)

    @property
    def overhang(self) -> float:
        """Largest overhang of a sphere [m], at most `delta` at size 1 or more unless a shape is `LARGE`."""
        return max(shape.cover.overhang for shape in self.shapes)


def coverage(robot: RobotModel, delta: float = DELTA, progress: Progress = log_task) -> Coverage:
    """Return covers and inner balls of a robot's collision shapes; kept on disk.

    Args:
        delta: By how much the covers may leave the shapes [m], at size 1.
        progress: Called before each shape that isn't known yet; what it raises comes through.

    Raises:
        ValueError: if `delta` is not positive.
    """
    if not (delta > 0.0 and np.isfinite(delta)):
        raise ValueError(f"`delta` must be positive, got {delta} m")
    COVERS.all(robot, delta, progress)
    return _coverage(robot, delta)


@memoized
def _coverage(robot: RobotModel, delta: float) -> Coverage:
    return Coverage(cast("tuple[ShapeCoverage, ...]", recall_coverage(robot, delta)), delta)


def recall_coverage(robot: RobotModel, delta: float = DELTA) -> tuple[ShapeCoverage | None, ...]:
    """Return what `coverage` does for each shape, where it is in memory or on disk; None elsewhere."""
    return COVERS.recall(robot, delta)


def _question(shape: Any, delta: float, unit: float) -> Question:
    """Make the search for the balls of a shape with lengths in a unit [m]."""
    kind = next((kind for kind in _KINDS if isinstance(shape, kind)), None)
    if kind is None:
        raise TypeError(f"a robot's collision shape can't be a {type(shape).__name__}")
    inputs, build = _KINDS[kind]
    delta *= SMALL if unit < 1.0 else 1.0
    arrays = inputs(shape)
    arrays = scale(arrays, 1.0 / unit, *(arrays.keys() - {"triangles"}))
    return (
        f"coverage-{kind.__name__.lower()}",
        {**arrays, "delta": np.array(delta), "gap": np.array(WIDEST_GAP)},
        lambda: _store(build(arrays, delta)),
    )


def _allowance(area: float, delta: float) -> float:
    """Return by how much the cover of a surface of an area [m^2] may leave it [m]; see `LARGE`."""
    return max(delta, float(np.sqrt(area / LARGE)))


def _mesh(arrays: Arrays, delta: float) -> ShapeCoverage:
    mesh = arrays["vertices"], arrays["triangles"], WIDEST_GAP
    body, outer = near_solid_of_mesh(*mesh), fill_solid_of_mesh(*mesh)
    if _allowance(body.area, delta) < LEAST_REACHES * body.reach:
        body = solid_of_mesh(*mesh)
        outer = fill_hollows(body)
    return ShapeCoverage(cover(outer, _allowance(body.area, delta)), inner_balls(body).reshape(-1, 4))


def _mesh_arrays(shape: Any) -> Arrays:
    vertices, triangles = triangulation(shape)
    return {"vertices": vertices, "triangles": triangles}


def _box(arrays: Arrays, delta: float) -> ShapeCoverage:
    x, y, z = arrays["size"].tolist()
    allowed = _allowance(2.0 * (x * y + y * z + z * x), delta)
    return ShapeCoverage(cover_box(arrays["size"], allowed), inner_box(arrays["size"]))


def _sphere(arrays: Arrays, delta: float) -> ShapeCoverage:  # noqa: ARG001 - as the others
    radius = float(arrays["radius"])
    return ShapeCoverage(cover_sphere(radius), inner_sphere(radius))


def _cylinder(arrays: Arrays, delta: float) -> ShapeCoverage:
    radius, length = arrays["size"].tolist()
    allowed = _allowance(2.0 * np.pi * radius * (radius + length), delta)
    return ShapeCoverage(cover_cylinder(radius, length, allowed), inner_cylinder(radius, length))


def _capsule(arrays: Arrays, delta: float) -> ShapeCoverage:
    radius, length = arrays["size"].tolist()
    allowed = _allowance(2.0 * np.pi * radius * (2.0 * radius + length), delta)
    return ShapeCoverage(cover_capsule(radius, length, allowed), inner_capsule(radius, length))


_KINDS: dict[type, tuple[Callable[[Any], Arrays], Callable[[Arrays, float], ShapeCoverage]]] = {
    coal.Box: (lambda s: {"size": 2.0 * np.asarray(s.halfSide)}, _box),
    coal.Sphere: (lambda s: {"radius": np.array(s.radius)}, _sphere),
    coal.Cylinder: (lambda s: {"size": np.array([s.radius, 2.0 * s.halfLength])}, _cylinder),
    coal.Capsule: (lambda s: {"size": np.array([s.radius, 2.0 * s.halfLength])}, _capsule),
    coal.BVHModelBase: (_mesh_arrays, _mesh),
    coal.Convex: (_mesh_arrays, _mesh),
}
"""For each kind of shape the inputs that its balls depend on, and the function that finds them."""

_FIELDS = ("spheres", "overhangs", "groups", "first", "bound")


def _store(found: ShapeCoverage) -> Arrays:
    arrays = {name: getattr(found.cover, name) for name in _FIELDS}
    return {**arrays, "inner": found.inner}


def _restore(arrays: Arrays, unit: float) -> ShapeCoverage:
    arrays = scale(arrays, unit, "spheres", "overhangs", "groups", "bound", "inner")
    return ShapeCoverage(Cover(**{name: arrays[name] for name in _FIELDS}), arrays["inner"].reshape(-1, 4))


COVERS = ByShape("covering", _question, _restore)
"""By robot and by how much covers may leave the shapes [m], at size 1."""


TIGHT = 0.005  # a part that stands off its mesh by no more isn't halved [m], at size 1
MOST_PARTS = 4  # most parts of a mesh, whose triangles decide next. With 8, connections of a UR5 take as long


def convex_parts(robot: RobotModel, most: int = MOST_PARTS) -> tuple[Decomposition | None, ...]:
    """Return for each shape, in the geometry's order, its hull and convex parts that together contain it; kept on disk.

    A mesh has at most `most` parts. None for a primitive or hull, which is convex itself, and for a mesh that is flat.
    """
    return PARTS.all(robot, most, log_task)


def recall_parts(robot: RobotModel) -> tuple[Decomposition | None, ...]:
    """Return what `convex_parts` does, where it is in memory or on disk; None elsewhere, or without parts."""
    return PARTS.recall(robot, MOST_PARTS)


def _ask_parts(shape: Any, most: int, unit: float) -> Question | None:
    """Make the search for the parts of a mesh with lengths in a unit [m]; None for other shapes."""
    if not isinstance(shape, coal.BVHModelBase):
        return None
    vertices, triangles = triangulation(shape)
    vertices = vertices if unit == 1.0 else vertices / unit
    inputs = {
        "vertices": vertices,
        "triangles": triangles,
        "limits": np.array([WIDEST_GAP, TIGHT]),
        "most": np.array(most),
    }
    return "parts", inputs, lambda: _store_parts(_find_parts(vertices, triangles, most))


def _find_parts(vertices: np.ndarray, triangles: np.ndarray, most: int) -> tuple[ConvexPart, ...]:
    try:
        found = decompose(fill_solid_of_mesh(vertices, triangles, WIDEST_GAP), TIGHT, most)
    except ValueError:
        return ()
    return (found.hull, *found.parts)


_PART_FIELDS = ("vertices", "faces")


def _store_parts(parts: tuple[ConvexPart, ...]) -> Arrays:
    rows = [(part.hull.vertices, part.hull.triangles) for part in parts]
    empty = (np.empty((0, 3)), np.empty((0, 3), np.int64))
    columns = zip(empty, *rows, strict=True)
    return {
        **{name: np.concatenate(column) for name, column in zip(_PART_FIELDS, columns, strict=True)},
        "counts": np.array([[len(array) for array in row] for row in rows], np.int64).reshape(-1, 2),
        "stand_offs": np.array([part.stand_off for part in parts]),
    }


def _restore_parts(arrays: Arrays, unit: float) -> Decomposition | None:
    if not len(arrays["counts"]):
        return None
    arrays = scale(arrays, unit, "vertices", "stand_offs")
    first = np.cumsum(arrays["counts"], axis=0)[:-1]
    columns = [np.split(arrays[name], first[:, k]) for k, name in enumerate(_PART_FIELDS)]
    hull, *parts = (
        ConvexPart(Surface(vertices, faces), float(distance))
        for distance, vertices, faces in zip(arrays["stand_offs"], *columns, strict=True)
    )
    return Decomposition(tuple(parts), hull)


PARTS = ByShape("cutting", _ask_parts, _restore_parts)  # by robot and by how many parts a mesh may have
