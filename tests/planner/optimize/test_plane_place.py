"""A guide plane as a place: nothing is missed where the tip is on it and inside, and derivatives are differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.passages import PlanePlace, add_passage, nearest
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.guide_plane import GuidePlane, build
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped

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
    """A problem, a chart point and the tip there."""
    planned: PlanningGroup = GROUPS[name]()
    made_for = problem(planned, scene_of(), planes=())
    z = 0.8 * planned.chart(planned.random(np.random.default_rng(seed)))
    z = np.clip(z, planned.lower + 0.1, planned.upper - 0.1)
    return made_for, z, made_for.kinematics.tip_position(planned.expand_from_chart(z))


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("shift", [0.0, -0.98, -1.3], ids=["inside", "near an edge", "beyond it"])
def test_its_rows_are_finite_differences_of_what_is_missed(name: str, shift: float) -> None:
    made_for, z, tip = made(name)
    place = PlanePlace(made_for, plane_through(tip + 0.01, shift=shift), 0.03)
    step = 1e-6
    moved = step * np.eye(len(z))
    differences = (place.missed(z + moved) - place.missed(z - moved)).T / (2.0 * step)
    np.testing.assert_allclose(place.rows(z), differences, atol=1e-7)


@pytest.mark.parametrize("name", GROUPS)
def test_nothing_is_missed_exactly_where_the_tip_is_on_the_inset_polygon(name: str) -> None:
    made_for, z, tip = made(name)
    rng = np.random.default_rng(4)
    for shift in np.linspace(-1.5, 1.5, 13):
        place = PlanePlace(made_for, plane_through(tip + 1e-3 * rng.normal(), shift=shift), 0.02)
        missed = place.missed(z[None])[0]
        assert abs(missed[0]) == pytest.approx(abs(place.plane.signed_height(tip)), abs=1e-12)
        assert (missed[1:] == 0.0).all() == place.plane.contains(tip, place.inset)
        assert np.linalg.norm(missed) == pytest.approx(place.plane.distance(tip, place.inset), abs=1e-9)


@dataclass(frozen=True)
class Plainly:
    """A place as `passages` looks at any that kernels know nothing of."""

    place: PlanePlace
    tip_plane: None = None

    def missed(self, zs: np.ndarray) -> np.ndarray:
        return self.place.missed(zs)

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
