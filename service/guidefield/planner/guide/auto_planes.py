"""Derive guide planes that nobody gave: along a coarse path of the tip, at bottlenecks, mouths and bends.

service/docs/algorithm.md, "Guide planes that nobody gave": a wavefront finds the path; planes stand where it is
narrowest, where free space turns into a passage (a taper is not narrowest at its mouth), and where the centres of two
planes don't see each other. Each is the free cross-section there, and is moved along the path to the smallest one
nearby.

A plane is a proposal, and a section without an area gives none: other constants, above 0, give other planes or none,
and so other motions. Lengths are for a robot of size 1. Names of planes are in replies, `RAYS` is in that document.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from guidefield.errors import SceneInvalid
from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.kernels.guide.free_space import (
    CAP,
    free_section,
    is_enclosed,
    open_areas as open_areas_kernel,
    wavefront,
)
from guidefield.messages import scene as messages
from guidefield.planner.guide.guide import arm_reach, tip_radius
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.guide_plane import GuidePlane, axes_across, build, centroid

GRID_SPACING = 0.05  # spacing of the grid in which the tip's path is searched for [m], at size 1. Unrecorded
MOST_POINTS = 2_000_000  # points of the grid, in memory: it is made coarser where it would have more. Unrecorded
LEAST_RADIUS = 0.005  # radius of a tip whose joint carries no body: it passes any gap that the grid sees [m]
MOST_BETWEEN = 1000  # points that are examined between the start and a goal in its cell of the grid, at most. A choice
AROUND = 0.3  # distance by which the grid extends beyond obstacles, start and goal [m]. Unrecorded
# clearance at which a path costs twice its length [m]: the search prefers paths with much of it. Unrecorded
COMFORTS = (0.2, 0.1, 0.05, 0.02)
LEAST_AMPLE = 0.1  # clearance that counts even where an end is in a narrower tube [m]. Unrecorded
SMOOTHINGS = 8  # how often the path is drawn straight and pushed off the obstacles. Unrecorded
PUSH = 0.3  # share of what is missing to free clearance by which a point of the path is pushed. Unrecorded
CLEARANCE_KEPT = 0.98  # no point of the path keeps less than this share of the clearance that it had. Unrecorded
RAYS = 24  # rays by which a free section is cut. Unrecorded
COMPARED_RAYS = 12  # rays by which areas are compared, and enclosed points recognized. Unrecorded
LONGEST_RAY = 0.4  # rays are followed no farther [m]: a plane in the open is this large. Unrecorded
MOUTH = 0.8  # a passage begins where clearance falls below this share of what counts as free. Unrecorded
PLATEAU = 0.02  # clearances that differ by less than this share are one plateau. Unrecorded
SIGHT = 0.5  # centres see each other if their straight path keeps this share of their clearance. Unrecorded
SIGHT_STEP = 0.02  # spacing of the points that are examined along a line of sight [m]. Unrecorded
NEARBY = 3  # points of the path by which a plane may be moved to a smaller section. Unrecorded
APART = 0.1  # planes nearer to each other, to the start or to the goal than this are one [m]. Unrecorded
CENTRINGS = 2  # how often a section is cut anew about its own middle. Unrecorded
CENTRED = 0.5  # share of the clearance on the path that its middle keeps. Unrecorded
DISTINCT = 1e-3  # corners nearer than this share of a section's size are one. Unrecorded


@dataclass(frozen=True, eq=False)
class TipPath(ReadOnly):
    """Points of a path, about evenly spaced."""

    points: np.ndarray  # shape (n, 3) [m, world]
    tangents: np.ndarray  # unit vectors along it, shape (n, 3)
    clearances: np.ndarray  # distance to obstacles, at most `CAP` at its size, shape (n,) [m]
    size: float


def find_tip_path(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, radius: float, centre: np.ndarray, reach: float,
    ample: float = np.inf, size: float = 1.0,
) -> TipPath | None:  # fmt: skip
    """The path of the tip with most clearance for its length, of those an arm can lie along if there are any.

    None: there is none, or an end is in contact. Start and goal are points (3,) [m, world], the radius is that of the
    tip's body [m], which counts as a ball: nothing nearer to obstacles, or than half the ends' clearance where that is
    less, is passed. The tip can't be farther from the centre (3,) than `reach` [m], which may be infinite; clearance
    beyond `ample` [m] is worth no detour.
    """
    low, high = _box(tables, start, goal, centre, reach, AROUND * size)
    spacing = max(GRID_SPACING * size, float(np.cbrt(np.prod(high - low) / MOST_POINTS)))
    low = start - spacing * np.ceil((start - low) / spacing)  # the start is a point of the grid
    counts = np.ceil((high - low) / spacing).astype(np.int64) + 1
    first, last = (np.rint((end - low) / spacing).astype(np.int64) for end in (start, goal))
    beside = bool((first == last).all())
    ends = measure_point_clearances(tables, np.array([start, goal if beside else low + spacing * last]), size)
    floor = float(min(radius or LEAST_RADIUS * size, 0.5 * ends.min()))
    if floor <= 0.0:
        return None
    if beside:
        return _straight_tip_path(tables, start, goal, floor, size)
    found = np.empty(int(np.prod(counts)), np.int64)
    free = np.full(len(found), np.nan, np.float32)
    cap, comforts = CAP * size, [comfort * size for comfort in COMFORTS]
    ample = float(np.clip(ample, LEAST_AMPLE * size, cap))
    for comfort, arm in (*((comfort, reach) for comfort in comforts), (comforts[0], np.inf)):
        n = wavefront(
            tables, low, spacing, counts, first, last, cap, comfort, ample, floor, centre, reach, arm, free, found
        )
        if n >= 2:
            points = low + spacing * np.stack(np.unravel_index(found[:n][::-1], tuple(counts)), axis=1)
            points[-1] = goal
            return _smooth(tables, points, size)
    return None


def find_free_section(tables: DistanceTables, centre: np.ndarray, across: np.ndarray, size: float = 1.0) -> np.ndarray:
    """The free section of a plane about a point (3,): convex, counter-clockwise, (k, 2) along `across` (2, 3).

    What is left of a wide one by a cut across each ray where it hits.
    """
    corners = np.empty((2 * RAYS, 2))
    return corners[: free_section(tables, centre, across, LONGEST_RAY * size, corners)]


def measure_open_areas(tables: DistanceTables, centres: np.ndarray, across: np.ndarray, size: float) -> np.ndarray:
    """Areas of planes about points (n, 3), along unit vectors (n, 2, 3), that are seen from there, shape (n,) [m^2]."""
    areas = np.empty(len(centres))
    open_areas_kernel(tables, centres, across, LONGEST_RAY * size, COMPARED_RAYS, areas)
    return areas


def is_in_passage(tables: DistanceTables, point: np.ndarray, normals: np.ndarray, size: float = 1.0) -> bool:
    """Return whether a point (3,) is in a passage: all rays from it hit in one of the planes with normals (n, 3)."""
    across = np.array([axes_across(normal) for normal in normals])
    return is_enclosed(tables, point, across, LONGEST_RAY * size, COMPARED_RAYS)


def measure_point_clearances(tables: DistanceTables, points: np.ndarray, size: float = 1.0) -> np.ndarray:
    """Distance of points (n, 3) to the obstacles, at most `CAP` at a size, shape (n,) [m]."""
    clear: np.ndarray = np.minimum(distance_at_points(tables, points, CAP * size)[0], CAP * size)
    return clear


def _box(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, centre: np.ndarray, reach: float, around: float
) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.minimum(start, goal) - around, np.maximum(start, goal) + around
    if len(tables.nodes):
        low, high = np.minimum(low, tables.nodes[0, :3] - around), np.maximum(high, tables.nodes[0, 3:] + around)
    if np.isfinite(reach):
        low, high = np.maximum(low, centre - reach), np.minimum(high, centre + reach)
        low, high = np.minimum(low, np.minimum(start, goal)), np.maximum(high, np.maximum(start, goal))
    return low, high


def _straight_tip_path(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, floor: float, size: float
) -> TipPath | None:
    """The straight path to a goal in the start's grid cell; None where something may be nearer than the floor."""
    length = float(np.linalg.norm(goal - start))
    steps = min(1 + int(length / floor), MOST_BETWEEN)
    between = measure_point_clearances(tables, np.linspace(start, goal, steps + 1), size)
    if between.min() < max(floor, 0.5 * length / steps):  # balls of this radius cover the path
        return None
    return _smooth(tables, np.array([start, goal]), size)


def _smooth(tables: DistanceTables, points: np.ndarray, size: float) -> TipPath:
    """The path as a band: drawn straight, pushed off the obstacles; no point of it loses clearance."""
    least, cap = CLEARANCE_KEPT * measure_point_clearances(tables, points, size), CAP * size
    for _ in range(SMOOTHINGS):
        distances, away, _ = distance_at_points(tables, points, cap)
        tangents = _tangents(points)
        away -= np.einsum("ij,ij->i", away, tangents)[:, None] * tangents
        moved = points.copy()
        moved[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        moved[1:-1] += (PUSH * (cap - np.minimum(distances, cap))[:, None] * away)[1:-1]
        keeps = measure_point_clearances(tables, moved, size) >= least
        points = np.where(keeps[:, None], moved, points)
    return TipPath(points, _tangents(points), measure_point_clearances(tables, points, size), size)


def _tangents(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) along points, from the second before to the second after each."""
    at = np.arange(len(points))
    along = points[np.minimum(at + 2, len(points) - 1)] - points[np.maximum(at - 2, 0)]
    tangents: np.ndarray = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return tangents


NORMALS = np.array([n for n in itertools.product((-1.0, 0.0, 1.0), repeat=3) if n > (0.0, 0.0, 0.0)])
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
"""Normals of planes in which a point may be enclosed, where none is given: along axes and diagonals, shape (13, 3)."""


def derive_planes(problem: Problem, goal: np.ndarray | GuidePlane) -> tuple[GuidePlane, ...] | None:
    """Planes that lead the tip to a point (3,) [m] or a plane's centroid, GP-auto-1, GP-auto-2 ...

    None if there is no path, or an end is in contact; no planes if the tip sees the goal from the start.
    """
    tables = distance_tables(problem.world.scene)
    start = problem.kinematics.tip_position(problem.group.expand_from_local(problem.z_start))
    place, normals = (goal.centroid, goal.normal[None]) if isinstance(goal, GuidePlane) else (goal, NORMALS)
    centre, reach = arm_reach(problem.group)
    size = problem.group.size
    ample = min(_ample_clearance(tables, start, NORMALS, size), _ample_clearance(tables, place, normals, size))
    path = find_tip_path(tables, start, place, tip_radius(problem.group), centre, reach, ample, size)
    if path is None:
        return None
    confined, chosen = path.clearances < MOUTH * CAP * path.size, list[int]()
    mouths = set((np.flatnonzero(confined[1:] & ~confined[:-1]) + 1).tolist())
    for at in sorted(_find_bottlenecks(path) | mouths):
        chosen = _add_place(path, chosen, _find_smallest_section(tables, path, at))
    planes = [_plane(tables, path, at, number) for number, at in enumerate(_add_bends(tables, path, chosen), 1)]
    return tuple(plane for plane in planes if plane is not None)


def _ample_clearance(tables: DistanceTables, end: np.ndarray, normals: np.ndarray, size: float) -> float:
    """Clearance that is ample for a path with such an end [m].

    From a tube no path is roomier than the tube: more clearance elsewhere is worth no detour. So a goal inside a tube
    is reached through the tube, and not round it and in at its far end.
    """
    return (
        float(measure_point_clearances(tables, end[None], size)[0])
        if is_in_passage(tables, end, normals, size)
        else CAP * size
    )


def _add_place(path: TipPath, chosen: list[int], place: int) -> list[int]:
    others = [0, len(path.points) - 1, *chosen]
    if min(float(np.linalg.norm(path.points[place] - path.points[other])) for other in others) < APART * path.size:
        return chosen
    return sorted([*chosen, place])


def _find_bottlenecks(path: TipPath) -> set[int]:
    """Local minima of clearance; of a plateau its first and last point."""
    clear, found = path.clearances, set()
    first = 0
    for k in range(1, len(clear)):
        if abs(clear[k] - clear[first]) <= PLATEAU * clear[first]:
            continue
        falls = first > 0 and clear[first - 1] > clear[first]
        if falls and clear[k] > clear[k - 1] and clear[first] < CAP * path.size:
            found |= {first, k - 1}
        first = k
    return found


def _add_bends(tables: DistanceTables, path: TipPath, chosen: list[int]) -> list[int]:
    """With one between every two, start and goal among them, that don't see each other: farthest from their chord."""
    looked = [0, *chosen, len(path.points) - 1]
    k = 0
    while k + 1 < len(looked):
        a, b = looked[k], looked[k + 1]
        if b - a < 3 or _can_see(tables, path, a, b):
            k += 1
            continue
        chord = path.points[b] - path.points[a]
        between = path.points[a + 1 : b] - path.points[a]
        share = np.clip(between @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        away = np.linalg.norm(between - share[:, None] * chord, axis=1)
        bend = _find_smallest_section(tables, path, a + 1 + int(np.argmax(away)), (a, b))
        if _add_place(path, [place for place in looked if 0 < place < len(path.points) - 1], bend).count(bend):
            looked.insert(k + 1, bend)
        else:
            k += 1
    return looked[1:-1]


def _can_see(tables: DistanceTables, path: TipPath, a: int, b: int) -> bool:
    """Return whether the straight path between two places keeps a share of the clearance that they have."""
    step = SIGHT_STEP * path.size
    steps = max(2, int(np.ceil(float(np.linalg.norm(path.points[b] - path.points[a])) / step)))
    points = np.linspace(path.points[a], path.points[b], steps + 1)
    local = float(min(path.clearances[a], path.clearances[b]))
    return float(measure_point_clearances(tables, points, path.size).min()) >= SIGHT * local


def _find_smallest_section(
    tables: DistanceTables, path: TipPath, place: int, within: tuple[int, int] | None = None
) -> int:
    """The place near another, and within a segment of the path, where the section is smallest."""
    first, last = within or (0, len(path.points) - 1)
    places = np.arange(max(first + 1, place - NEARBY), min(last, place + NEARBY + 1))
    if not len(places):
        return place
    across = np.array([axes_across(path.tangents[k]) for k in places])
    areas = measure_open_areas(tables, path.points[places], across, path.size)
    return int(places[np.lexsort([np.abs(places - place), areas])[0]])


def _plane(tables: DistanceTables, path: TipPath, place: int, number: int) -> GuidePlane | None:
    across = axes_across(path.tangents[place])
    centre = path.points[place].copy()
    for _ in range(CENTRINGS):
        moved = centre + centroid(find_free_section(tables, centre, across, path.size)) @ across
        if measure_point_clearances(tables, moved[None], path.size)[0] < CENTRED * path.clearances[place]:
            break
        centre = moved
    corners = _merge_corners(find_free_section(tables, centre, across, path.size))
    if len(corners) < 3:
        return None
    vertices = [tuple(vertex) for vertex in (centre + corners @ across).tolist()]
    try:
        return build(messages.GuidePlane(name=f"GP-auto-{number}", vertices=vertices), number - 1)
    except SceneInvalid:
        return None


def _merge_corners(corners: np.ndarray) -> np.ndarray:
    size = float(np.ptp(corners, axis=0).max())
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    distinct: np.ndarray = corners[sides > DISTINCT * size]
    return distinct
