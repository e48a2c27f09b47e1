"""The guide plane: a convex, flat polygon in free space that the tip has to reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import SceneInvalid
from guidefield.kernels.distance.convex_polygon import inradius
from guidefield.messages import scene as messages
from guidefield.scene.flat import PLANARITY, FlatPolygon, centroid, flat_polygons, flatness_faults

SLACK = 1e-8  # rounding that `contains` forgives, as a fraction of the size: a closest point is contained


@dataclass(frozen=True, eq=False)
class GuidePlane:
    """A convex, flat polygon.

    The *inset* polygon holds the points of the polygon that are at least a given distance from its edges [m]. An inset
    beyond the inradius represents the inradius: the rest then is the deepest point, or the deepest stretch.
    """

    name: str
    vertices: np.ndarray  # corners, shape (k, 3) [m, world], counter-clockwise about the unit normal (3,)
    normal: np.ndarray
    centroid: np.ndarray  # of the area, shape (3,) [m, world]
    inradius: float  # radius of the largest circle inside [m]
    flat: FlatPolygon  # the polygon in its plane
    # ``inward[i] . x - offsets[i]`` is the height of x in the plane over edge i, from corner i to i + 1 [m]; shapes (k,
    # 2) and (k,)
    inward: np.ndarray
    offsets: np.ndarray

    def signed_height(self, point: np.ndarray) -> float:
        """Distance of a point (3,) in the world from the plane [m], positive on the side of the normal."""
        return float(self.normal @ (point - self.flat.origin))

    def contains(self, point: np.ndarray, inset: float = 0.0) -> bool:
        """Return whether the foot of a point (3,) [m, world] lies in the inset polygon, whatever its height."""
        return self.depth(point) >= min(inset, self.inradius) - SLACK * self.flat.size

    def depth(self, point: np.ndarray) -> float:
        """Return the depth of a point's foot (3,) inside the nearest edge [m], negative outside."""
        return self._depth(self.flat.axes @ (point - self.flat.origin))

    def closest_point(self, point: np.ndarray, inset: float = 0.0) -> np.ndarray:
        """The point (3,) of the inset polygon that is closest to a point (3,) [m, world]."""
        inset = min(inset, self.inradius)
        foot = self.flat.axes @ (point - self.flat.origin)
        if self._depth(foot) < inset:
            foot = _closest_on_outline(foot, self._inset_corners(inset))
        closest: np.ndarray = self.flat.origin + foot @ self.flat.axes
        return closest

    def distance(self, point: np.ndarray, inset: float = 0.0) -> float:
        """Return the distance of a point (3,) from the inset polygon [m, world]."""
        return float(np.linalg.norm(point - self.closest_point(point, inset)))

    def inset_vertices(self, inset: float) -> np.ndarray:
        """Corners of the inset polygon, shape (m, 3) [m, world]; fewer where an edge has vanished."""
        return self.flat.from_plane(self._inset_corners(min(inset, self.inradius)))

    def _depth(self, foot: np.ndarray) -> float:
        return float((self.inward @ foot - self.offsets).min())

    def _inset_corners(self, inset: float) -> np.ndarray:
        if inset <= 0.0:
            return self.flat.corners
        moved = _inset(self.flat.corners, self.inward, inset)
        if moved is not None:
            return moved
        # At the inradius itself rounding decides whether anything is left.
        return _clip(self.flat.corners, self.inward, self.offsets + inset * (1.0 - 1e-9))


def build_all(declared: Sequence[messages.GuidePlane], deadline: Deadline = UNLIMITED) -> tuple[GuidePlane, ...]:
    """Build guide planes; raises SceneInvalid as `build`, DeadlineExpired if the deadline passed before."""
    built = []
    for index, message in enumerate(declared):
        if index:
            deadline.check("the guide planes were built")
        built.append(build(message, index))
    return tuple(built)


def build(message: messages.GuidePlane, index: int) -> GuidePlane:
    """Check a guide plane, that of an index in its scene, and make it ready for questions.

    Raises SceneInvalid if it isn't flat, isn't convex or has no area; `details` name the plane and the path.
    """
    flats = flat_polygons(np.array(message.vertices, float)[None])
    flat = flats.one(0)
    fault = flatness_faults(flats).get(0) or _convexity_fault(flat)
    if fault is not None:
        raise SceneInvalid(
            f"guide plane {message.name!r}: {fault}", guide_plane=message.name, path=f"$.guide_planes[{index}].vertices"
        )
    edges = np.roll(flat.corners, -1, axis=0) - flat.corners
    inward = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", inward, flat.corners)
    middle = flat.from_plane(centroid(flat.corners)[None])[0]
    for array in (inward, offsets, middle):
        array.setflags(write=False)
    return GuidePlane(
        name=message.name,
        vertices=flat.vertices,
        normal=flat.normal,
        centroid=middle,
        inradius=inradius(inward, offsets, PLANARITY),
        flat=flat,
        inward=inward,
        offsets=offsets,
    )


def _convexity_fault(flat: FlatPolygon) -> str | None:
    before, after = np.roll(flat.corners, 1, axis=0), np.roll(flat.corners, -1, axis=0)
    arriving, leaving = flat.corners - before, after - flat.corners
    cross = arriving[:, 0] * leaving[:, 1] - arriving[:, 1] * leaving[:, 0]
    # How deep the corner dents the polygon: its distance from the chord of its neighbours.
    chords = np.linalg.norm(after - before, axis=1)
    dents = -cross / np.maximum(chords, PLANARITY * flat.size)
    worst = int(np.argmax(dents))
    if dents[worst] > PLANARITY * flat.size:
        return f"it is not convex: vertex {worst} dents it by {dents[worst]:.3g} m"
    turns = np.arctan2(cross, np.einsum("ij,ij->i", arriving, leaving))
    if abs(turns.sum() - 2.0 * np.pi) > 1e-3:
        return f"it is not convex: its edges turn {turns.sum() / (2.0 * np.pi):.2f} times around instead of once"
    return None


def _inset(corners: np.ndarray, inward: np.ndarray, inset: float) -> np.ndarray | None:
    """Corners after all edges moved inwards; None once an edge has vanished, whose length falls linearly until then."""
    arriving = np.roll(inward, 1, axis=0)
    mitre = (arriving + inward) / (1.0 + np.einsum("ij,ij->i", arriving, inward))[:, None]
    moved: np.ndarray = corners + inset * mitre
    edges = np.roll(moved, -1, axis=0) - moved
    if (inward[:, 1] * edges[:, 0] - inward[:, 0] * edges[:, 1]).min() > 0.0:
        return moved
    return None


def _clip(corners: np.ndarray, inward: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Clip a convex polygon by half-planes ``inward . x >= offset``; shape (m, 2), m may be 0."""
    for normal, offset in zip(inward, offsets, strict=True):
        heights = corners @ normal - offset
        if heights.min() >= 0.0:
            continue
        if heights.max() < 0.0:
            return np.empty((0, 2))
        after, heights_after = np.roll(corners, -1, axis=0), np.roll(heights, -1)
        cut = heights * heights_after < 0.0
        share = np.where(cut, heights / np.where(cut, heights - heights_after, 1.0), 0.0)
        crossings = corners + share[:, None] * (after - corners)
        both = np.stack([corners, crossings], axis=1).reshape(-1, 2)
        corners = both[np.stack([heights >= 0.0, cut], axis=1).ravel()]
    return corners


def _closest_on_outline(foot: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Point (2,) of a closed outline (m, 2), m >= 1, that is closest to another."""
    along = np.roll(corners, -1, axis=0) - corners
    lengths = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", foot - corners, along) / np.where(lengths > 0.0, lengths, 1.0)
    points = corners + np.clip(share, 0.0, 1.0)[:, None] * along
    closest: np.ndarray = points[np.argmin(np.einsum("ij,ij->i", points - foot, points - foot))]
    return closest
