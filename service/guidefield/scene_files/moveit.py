"""MoveIt's scene files (`.scene`), as its RViz panel writes them: objects, of one or several shapes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import SceneInvalid
from guidefield.geometry.placements import se3
from guidefield.messages.scene import Box, Cylinder, HalfSpace, Mesh, Sphere
from guidefield.messages.triples import MAX_VERTICES
from guidefield.scene_files.builder import Kind, SceneBuilder, cone

PRIMITIVES: dict[str, tuple[Kind, tuple[str, ...]]] = {
    "box": (Box, ("size",)),
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius", "length")),
    "cone": (cone, ("radius", "length")),
}
"""Class and fields of each shape that has sizes alone; a box has three."""


def read_moveit_scene(text: str, builder: SceneBuilder) -> None:
    """Read a scene of MoveIt, of either form.

    Raises:
        SceneInvalid: if it is malformed, cut short, or has a shape that can't be judged; names line and object.
    """
    lines = _Lines(text)
    lines.next_line("the name of the scene")
    is_posed: bool | None = None
    while (marker := lines.next_line("the line '.' at the end").strip()) != ".":
        if not marker.startswith("*"):
            raise lines.fault(f"an object begins with '* NAME' and the file ends with '.', got {marker[:40]!r}")
        name = marker[1:].strip()
        if is_posed is None:  # as MoveIt tells its forms apart: what follows is a position, or a number of shapes
            is_posed = len(lines.peek().split()) > 1
        pose = _pose(lines, name) if is_posed else pin.SE3.Identity()
        for _ in range(lines.count(f"shapes of {name!r}")):
            _add_shape(lines, name, pose, builder)
        for _ in range(lines.count(f"subframes of {name!r}") if is_posed else 0):
            lines.next_line("the name of a subframe")
            _pose(lines, name)


class _Lines:
    """Lines of a text, and the numbers in them."""

    def __init__(self, text: str) -> None:
        self._lines, self._at = text.splitlines(), 0

    def fault(self, message: str) -> SceneInvalid:
        """Return the error about the line that was read last."""
        return SceneInvalid(f"line {self._at}: {message}", line=self._at)

    def peek(self) -> str:
        """Return the next line, or nothing, and stay before it."""
        return next((line for line in self._lines[self._at :] if line.strip()), "")

    def next_line(self, what: str) -> str:
        """Return the next line that isn't blank; `what` it should be is for an error."""
        while self._at < len(self._lines):
            self._at += 1
            if self._lines[self._at - 1].strip():
                return self._lines[self._at - 1]
        raise self.fault(f"the file ends before {what}: it is cut short")

    def numbers(self, count: int, what: str) -> list[float]:
        """Return the numbers of the next lines, which must hold `count` of them."""
        values: list[float] = []
        while len(values) < count:
            for word in self.next_line(what).split():
                try:
                    values.append(float(word))
                except ValueError:
                    raise self.fault(f"{what}: {word[:40]!r} is no number") from None
        if len(values) > count or not all(map(math.isfinite, values)):
            raise self.fault(f"{what} must be {count} finite numbers, got {values[:8]}")
        return values

    def count(self, what: str, most: int = MAX_VERTICES) -> int:
        """Return a number of things."""
        (value,) = self.numbers(1, f"the number of {what}")
        if not (value.is_integer() and 0 <= value <= most):
            raise self.fault(f"the number of {what} must be whole and at most {most}, got {value:g}")
        return int(value)


def _pose(lines: _Lines, name: str) -> Any:
    position = lines.numbers(3, f"the position of {name!r}")
    quaternion = lines.numbers(4, f"the quaternion of {name!r}")
    if math.hypot(*quaternion) < 1e-9:
        raise lines.fault(f"the quaternion of {name!r} is zero")
    return se3(position, quaternion)


def _add_shape(lines: _Lines, name: str, pose: Any, builder: SceneBuilder) -> None:
    shape = lines.next_line(f"a shape of {name!r}").strip()
    where, sizes, local = f"line {lines._at}: ", dict[str, Any](), pin.SE3.Identity()
    kind: Kind
    if shape in PRIMITIVES:
        kind, fields = PRIMITIVES[shape]
        values = lines.numbers(3 if shape == "box" else len(fields), f"the sizes of the {shape} of {name!r}")
        sizes = {"size": values} if shape == "box" else dict(zip(fields, values, strict=True))
    elif shape == "plane":
        kind = HalfSpace
        *normal, offset = lines.numbers(4, f"the plane of {name!r}")
        if (length := math.hypot(*normal)) < 1e-9:
            raise lines.fault(f"the plane of {name!r} has no normal")
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(normal) / length)
        local = pin.SE3(turn.matrix(), np.array(normal) * (-offset / length**2))
    elif shape == "mesh":
        kind = Mesh
        corners, triangles = map(int, lines.numbers(2, f"the numbers of vertices and triangles of {name!r}"))
        if not (0 < corners <= MAX_VERTICES and 0 < triangles <= MAX_VERTICES):
            raise lines.fault(f"the mesh of {name!r} must have 1 to {MAX_VERTICES} vertices and triangles")
        vertices = np.array(lines.numbers(3 * corners, f"the vertices of {name!r}")).reshape(-1, 3)
        indices = np.array(lines.numbers(3 * triangles, f"the triangles of {name!r}")).reshape(-1, 3)
        if not (indices.min() >= 0 and indices.max() < corners and (indices == np.floor(indices)).all()):
            raise lines.fault(f"the mesh of {name!r} has a triangle that names no vertex: there are {corners}")
        sizes = {"vertices": vertices, "triangles": indices}
    else:
        known = ", ".join((*PRIMITIVES, "plane", "mesh"))
        raise lines.fault(f"the shape {shape[:40]!r} of {name!r} can't be judged; shapes are {known}")
    local = _pose(lines, name) * local
    lines.numbers(4, f"the colour of {name!r}")
    builder.add(kind, name, pose * local, where=where, **sizes)
