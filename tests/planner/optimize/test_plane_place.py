"""A guide plane as a place: nothing is missed where the tip is on it and inside, and derivatives are differences."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.planner.optimize.plane_place import PlanePlace
from tests.planner.relax.test_plane_crossing import GROUPS, made, plane_through


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


def test_the_inset_is_what_the_crossing_had_where_that_is_less() -> None:
    made_for, z, tip = made("panda")
    near_edge = PlanePlace.through(made_for, plane_through(tip, shift=-0.98), z)
    assert near_edge.inset == pytest.approx(0.02 * 0.1, rel=1e-6)
    assert PlanePlace.through(made_for, plane_through(tip), z).inset > 0.004
    assert PlanePlace.through(made_for, plane_through(tip, shift=-1.1), z).inset == 0.0
