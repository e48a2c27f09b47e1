"""Independent answers: stored high-precision values, and plain formulas that share no code with ours."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

_FOLDER = Path(__file__).parent / "oracle"

EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class PolygonCase:
    """A charged polygon and its field at a point, computed with 60 digits and more; see oracle/README.md."""

    name: str
    tags: tuple[str, ...]
    vertices: np.ndarray
    point: np.ndarray
    potential: float
    gradient: np.ndarray
    hessian: np.ndarray
    solid_angle: float
    condition: float

    @property
    def triangles(self) -> np.ndarray:
        """The fan from the first corner, shape (k - 2, 3, 3)."""
        return fan(self.vertices)


@dataclass(frozen=True, eq=False)
class SolidCase:
    """A closed charged surface (mesh, sphere or capsule surrogate) and its field at a point."""

    name: str
    kind: str
    point: np.ndarray
    potential: float
    gradient: np.ndarray
    winding: float | None
    shape: dict[str, Any]


def polygon_cases() -> list[PolygonCase]:
    """The 73 polygons."""
    return [
        PolygonCase(
            name=case["name"],
            tags=(case["kind"], *case["tags"]),
            vertices=np.array(case["vertices"]),
            point=np.array(case["point"]),
            potential=case["potential"],
            gradient=np.array(case["gradient"]),
            hessian=np.array(case["hessian"]),
            solid_angle=case["solid_angle"],
            condition=case["extent"] / case["clearance"],
        )
        for case in _cases("potential_polygon.json")
    ]


def solid_cases() -> list[SolidCase]:
    """The 29 closed surfaces; `shape` has triangles, or center and radius, or p0, p1 and radius."""
    return [
        SolidCase(
            name=case["name"],
            kind=case["kind"],
            point=np.array(case["point"]),
            potential=case["potential"],
            gradient=np.array(case["gradient"]),
            winding=case.get("winding_number"),
            shape=_shape(case),
        )
        for case in _cases("potential_solids.json")
    ]


def fan(vertices: np.ndarray) -> np.ndarray:
    """Triangles from the first corner of a polygon, shape (k - 2, 3, 3)."""
    return np.array([[vertices[0], vertices[i], vertices[i + 1]] for i in range(1, len(vertices) - 1)])


def edge_sum_potential(point: np.ndarray, vertices: np.ndarray) -> float:
    """Potential of a flat polygon by one arctangent pair an edge (Wilton); loses digits near its plane and far away."""
    normal = np.cross(vertices - vertices[0], np.roll(vertices, -1, axis=0) - vertices[0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    h = abs(float(normal @ (point - vertices[0])))
    total = 0.0
    for start, end in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        q = float(np.cross(along, normal) @ (start - point))
        square = q * q + h * h
        for s, sign in ((float(along @ (end - point)), 1.0), (float(along @ (start - point)), -1.0)):
            total += sign * math.atan2(q * s, square + h * math.sqrt(s * s + square))
    return total / h


def distance_to_triangle(point: np.ndarray, corners: np.ndarray) -> float:
    """Distance from a point to a triangle, shape (3, 3): to its inside if the foot is there, else to its edges."""
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    edges = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    if all(normal @ np.cross(end - start, point - start) >= 0.0 for start, end in edges):
        return abs(float(normal @ (point - a)))
    return min(distance_to_segment(point, start, end) for start, end in edges)


def distance_to_segment(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Distance from a point to a segment, which may be a point."""
    axis = end - start
    square = float(axis @ axis)
    share = min(max(float((point - start) @ axis) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return float(np.linalg.norm(point - start - share * axis))


def _cases(name: str) -> list[dict[str, Any]]:
    stored = json.loads((_FOLDER / name).read_text())
    cases: list[dict[str, Any]] = stored["cases"]
    assert len(cases) == stored["count"]
    return cases


def _shape(case: dict[str, Any]) -> dict[str, Any]:
    if case["kind"] != "mesh":
        return {key: case[key] for key in ("center", "p0", "p1", "radius") if key in case}
    vertices = np.array(case["vertices"])
    return {"triangles": np.concatenate([fan(vertices[face]) for face in case["faces"]])}
