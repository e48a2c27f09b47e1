"""What is chosen holds the nearest triangle or point of every place in the ball."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st
from trimesh.triangles import closest_point

from guidefield.kernels.cover.crop_to_ball import crop_to_ball


def chosen_of(vertices: np.ndarray, corners: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    chosen = np.empty(len(corners), bool)
    crop_to_ball(vertices, corners, centre, radius, chosen)
    return chosen


def places_in(centre: np.ndarray, radius: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Places in a ball, a third of them on its surface."""
    away = rng.normal(size=(count, 3))
    away *= (radius * rng.uniform(0.0, 1.5, count).clip(max=1.0) / np.linalg.norm(away, axis=1))[:, None]
    return centre + away


def distances(triangles: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Of each triangle (n, 3, 3) from a place, shape (n,)."""
    nearest = closest_point(triangles, np.tile(place, (len(triangles), 1)))
    found: np.ndarray = np.linalg.norm(nearest - place, axis=1)
    return found


@settings(deadline=None, max_examples=18)
@given(
    st.integers(1, 300),
    st.floats(0.0, 3.0),
    st.floats(0.0, 4.0),
    st.floats(1e-3, 5.0),
    st.booleans(),
    st.integers(0, 10**6),
)
def test_the_nearest_of_every_place_is_chosen(
    count: int, size: float, away: float, radius: float, flat: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    middles = rng.uniform(-2.0, 2.0, (count, 3)) * [1.0, 1.0, 0.0 if flat else 1.0]
    triangles = middles[:, None] + size * rng.normal(size=(count, 3, 3)) * rng.uniform(0.0, 1.0, (count, 1, 1)) ** 3
    centre = away * rng.normal(size=3)
    chosen = chosen_of(triangles.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), centre, radius)
    points = chosen_of(middles, np.arange(count)[:, None], centre, radius)
    for place in places_in(centre, radius, 40, rng):
        apart = distances(triangles, place)
        assert apart[chosen].min() == apart.min()
        apart = np.linalg.norm(middles - place, axis=1)
        assert apart[points].min() == apart.min()
