"""Passages and guide planes as places: what missing them costs, its derivatives, and that nothing is missed."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.messages import scene as messages
from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.passages import REACHED, Passage, PlanePlace, add_passage, move_onto_places, nearest
from guidefield.planner.optimize.settings import BALANCED
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.guide_plane import GuidePlane, build
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped

PIECES = 10


@dataclass(frozen=True)
class Waypoint:
    """Local coordinates that is passed within a radius."""

    point: np.ndarray
    radius: float
    tip_plane: None = None

    def misses(self, zs: np.ndarray) -> np.ndarray:
        return np.maximum(np.linalg.norm(zs - self.point, axis=1) - self.radius, 0.0)[:, None]

    def rows(self, z: np.ndarray) -> np.ndarray:
        away = z - self.point
        return (away / np.linalg.norm(away))[None]


def curve(seed: int, nv: int = 3) -> BSpline:
    """Along the first coordinate, with others astray."""
    rng = np.random.default_rng(seed)
    points = 0.1 * rng.normal(size=(PIECES + 3, nv))
    points[:, 0] = np.linspace(0.0, 4.0, PIECES + 3)
    return BSpline.between(End.at_rest(points[1]), End.at_rest(points[-2]), points[3:-3], 0.2)


def least(spline: BSpline, place: Waypoint, about: float, window: float = 1.0) -> float:
    """Half the square of what is missed at least next to a place, by dense samples."""
    dense = np.clip(np.linspace(about - window, about + window, 2_001), 0.0, spline.pieces)
    return 0.5 * float((place.misses(spline.at(dense)) ** 2).sum(axis=1).min())


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_is_that_of_finite_differences_of_the_least_miss(seed: int) -> None:
    spline = curve(seed)
    place = Waypoint(spline.at(np.array([4.6]))[0] + [0.0, 0.3, 0.1], 0.05)
    n, nv = spline.points.shape
    gradient, places = np.zeros((n, nv)), (np.empty(1, np.int64), np.empty((1, 4)), np.empty((1, nv, nv)))
    at = nearest(place, spline, 4.6)
    value = add_passage(place, spline, at, 7.0, BALANCED.crossing, 0, gradient, *places)
    assert value == pytest.approx(7.0 * least(spline, place, at, 0.3), rel=1e-4)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        along = rng.normal(size=(n, nv))
        moved = (BSpline(spline.points + by * along, spline.step, spline.start, spline.end) for by in (1e-3, -1e-3))
        difference = np.subtract(*(least(one, place, at, 0.3) for one in moved)) / 2e-3
        assert float((gradient * along).sum()) == pytest.approx(7.0 * difference, rel=1e-2, abs=1e-3)


def test_its_hessian_is_positive_and_leaves_free_what_time_makes_up_for() -> None:
    spline = curve(1)
    place = Waypoint(spline.at(np.array([4.6]))[0] + [0.0, 0.3, 0.1], 0.0)
    n, nv = spline.points.shape
    at = nearest(place, spline, 4.6)
    pieces, shares, hessians = np.empty(1, np.int64), np.empty((1, 4)), np.empty((1, nv, nv))
    add_passage(place, spline, at, 1.0, BALANCED.crossing, 0, np.zeros((n, nv)), pieces, shares, hessians)
    by_point = np.zeros((n, 1))
    by_point[pieces[0] : pieces[0] + 4, 0] = shares[0]
    np.testing.assert_allclose((by_point * spline.points).sum(axis=0), spline.at(np.array([at]))[0])
    whole = np.kron(by_point @ by_point.T, hessians[0])
    assert np.linalg.eigvalsh(whole).min() > -1e-12
    away = spline.at(np.array([at]))[0] - place.point
    sideways = np.tile(away, (n, 1)).ravel()
    along = np.tile(spline.slopes(np.array([at]))[0], (n, 1)).ravel()
    assert sideways @ whole @ sideways > 0.1 * (away @ away)
    assert along @ whole @ along < 1e-3 * sideways @ whole @ sideways * (along @ along) / (sideways @ sideways)


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.floats(0.0, 0.02), st.floats(2.0, 6.0))
def test_a_motion_is_brought_exactly_to_all_places_and_its_ends_stay(seed: int, radius: float, at: float) -> None:
    spline = curve(seed)
    aside = 0.02 * np.random.default_rng(seed).normal(size=(2, 3))
    places = (at, at + 2.0)
    passages = [Passage(Waypoint(z + by, radius), z) for z, by in zip(spline.at(np.array(places)), aside, strict=True)]
    found = move_onto_places(spline, passages, places, np.ones(spline.points.shape[1]))
    moved, reached = found
    for passage, where in zip(passages, reached, strict=True):
        assert passage.place.misses(moved.at(np.array([where]))).max() <= REACHED
    np.testing.assert_array_equal(moved.points[:3], spline.points[:3])
    np.testing.assert_array_equal(moved.points[-3:], spline.points[-3:])


GROUPS = {
    "panda": lambda: group("panda"),
    "floating": lambda: grouped(box_arm("floating x y", 0)),
    "planar": lambda: grouped(box_arm("planar x y", 0)),
}


def plane_through(tip: np.ndarray, half: float = 0.1, shift: float = 0.0) -> GuidePlane:
    """A square across (1, 1, 0) around a point, moved within its plane by a share of its half side."""
    across, up = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), np.array([0.0, 0.0, 1.0])
    middle = tip + shift * half * across
    corners = [middle + half * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)


def made(name: str, seed: int = 0) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A problem, local coordinates and the tip there."""
    planned: PlanningGroup = GROUPS[name]()
    made_for = problem(planned, scene_of(), planes=())
    z = 0.8 * planned.to_local(planned.random(np.random.default_rng(seed)))
    z = np.clip(z, planned.lower + 0.1, planned.upper - 0.1)
    return made_for, z, made_for.kinematics.tip_position(planned.expand_from_local(z))


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("shift", [0.0, -0.98, -1.3], ids=["inside", "near an edge", "beyond it"])
def test_its_rows_are_finite_differences_of_what_is_missed(name: str, shift: float) -> None:
    made_for, z, tip = made(name)
    place = PlanePlace(made_for, plane_through(tip + 0.01, shift=shift), 0.03)
    step = 1e-6
    moved = step * np.eye(len(z))
    differences = (place.misses(z + moved) - place.misses(z - moved)).T / (2.0 * step)
    np.testing.assert_allclose(place.rows(z), differences, atol=1e-7)


@pytest.mark.parametrize("name", GROUPS)
def test_nothing_is_missed_exactly_where_the_tip_is_on_the_inset_polygon(name: str) -> None:
    made_for, z, tip = made(name)
    rng = np.random.default_rng(4)
    for shift in np.linspace(-1.5, 1.5, 13):
        place = PlanePlace(made_for, plane_through(tip + 1e-3 * rng.normal(), shift=shift), 0.02)
        missed = place.misses(z[None])[0]
        assert abs(missed[0]) == pytest.approx(abs(place.plane.signed_height(tip)), abs=1e-12)
        assert (missed[1:] == 0.0).all() == place.plane.contains(tip, place.inset)
        assert np.linalg.norm(missed) == pytest.approx(place.plane.distance(tip, place.inset), abs=1e-9)


@dataclass(frozen=True)
class Plainly:
    """A place as `passages` looks at any that kernels know nothing of."""

    place: PlanePlace
    tip_plane: None = None

    def misses(self, zs: np.ndarray) -> np.ndarray:
        return self.place.misses(zs)

    def rows(self, z: np.ndarray) -> np.ndarray:
        return self.place.rows(z)


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("shift", [0.0, -0.98, -1.3], ids=["inside", "near an edge", "beyond it"])
@pytest.mark.parametrize("away", [0.0, 0.05], ids=["crossing", "reaching"])
def test_kernels_find_what_is_found_of_any_place(name: str, shift: float, away: float) -> None:
    made_for, z, tip = made(name)
    rng, pieces = np.random.default_rng(5), 12
    points = z + 0.02 * rng.normal(size=(pieces + 3, len(z))) + np.linspace(-0.2, 0.2, pieces + 3)[:, None]
    spline = BSpline.between(End.at_rest(points[1]), End.at_rest(points[-2]), points[3:-3], 0.1)
    place = PlanePlace(made_for, plane_through(tip + away, shift=shift), 0.03)
    for about in (0.0, 3.3, 6.1, 12.0):
        at = nearest(place, spline, about)
        assert at == pytest.approx(nearest(Plainly(place), spline, about), abs=1e-6)
        found = []
        for one in (place, Plainly(place)):
            gradient, hessians = np.zeros(points.shape), np.empty((2, len(z), len(z)))
            pieces, basis = np.empty(2, np.int64), np.empty((2, 4))
            value = add_passage(one, spline, at, 7.0, 1e-3, 1, gradient, pieces, basis, hessians)
            found.append((value, gradient, pieces[1], basis[1], hessians[1]))
        for mine, plain in zip(*found, strict=True):
            np.testing.assert_allclose(mine, plain, rtol=1e-9, atol=1e-12)
