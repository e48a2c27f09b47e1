import math

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.kernels.cover.enclosing_ball import enclosing_circle
from guidefield.robot.link_charges import Capsule, fit_capsule
from tests.kernels.evaluation import vectors
from tests.oracles import distance_to_segment

laws = settings(deadline=None, max_examples=15)


def outside(capsule: Capsule, points: np.ndarray) -> float:
    return max(distance_to_segment(point, capsule.p0, capsule.p1) for point in points) - capsule.radius


def test_points_close_together_far_away_are_contained() -> None:
    points = np.array([7.3, -2.9, 8.8]) + 1e-15 * np.random.default_rng(2).normal(size=(20, 3))
    assert outside(fit_capsule(points), points) <= 0.0


@laws
@given(st.lists(vectors(10.0), min_size=1, max_size=40).map(np.array), st.floats(-5.0, 5.0))
def test_capsule_contains_its_points(points: np.ndarray, exponent: float) -> None:
    scaled = 10.0**exponent * points
    capsule = fit_capsule(scaled)
    assert outside(capsule, scaled) <= 0.0
    assert capsule.distance(scaled).max() <= 0.0
    # Not more than the ball about the middle of the box about the points, which is a capsule too.
    middle = 0.5 * (scaled.min(axis=0) + scaled.max(axis=0))
    ball = np.linalg.norm(scaled - middle, axis=1).max()
    # A quarter more, because the search is local.
    assert capsule.volume <= 1.25 * 4.0 / 3.0 * math.pi * (ball + 1e-14 * np.abs(scaled).max()) ** 3


@laws
@given(vectors(1.0), vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.3), st.floats(0.02, 0.2))
def test_a_capsule_is_found_again(start: np.ndarray, axis: np.ndarray, radius: float) -> None:
    length = float(np.linalg.norm(axis))
    frame = np.linalg.qr(np.column_stack([axis, np.eye(3)[np.abs(axis).argmin()]]), mode="complete")[0]
    along = frame[:, 0] * np.sign(frame[:, 0] @ axis)
    turn = np.column_stack([frame[:, 1], np.cross(along, frame[:, 1]), along])
    points = surfaces.capsule(radius, length).vertices @ turn.T + start
    capsule = fit_capsule(points)
    exact = math.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    assert outside(capsule, points) <= 0.0
    # Where it is short, a slanted one can beat it: its points are few.
    assert capsule.volume <= 1.001 * exact
    assert capsule.volume >= 0.9 * exact


@laws
@given(st.floats(1e-3, 1.0), st.floats(0.0, 10.0))
def test_the_capsule_about_a_round_shape_contains_it(radius: float, ratio: float) -> None:
    """Motions are proved by capsules fitted to triangulated links: whose vertices alone are on a round one."""
    length = ratio * radius
    for shape, half in ((surfaces.sphere(radius), 0.0), (surfaces.capsule(radius, length), 0.5 * length)):
        capsule, end = fit_capsule(shape.vertices), np.array([0.0, 0.0, half])
        ball = radius * surfaces.spread_directions(500)
        ends = np.concatenate([ball + end, ball - end])
        assert capsule.distance(ends).max() <= 0.0


@laws
@given(st.lists(vectors(10.0).map(lambda v: v[:2]), min_size=1, max_size=12).map(np.array))
def test_enclosing_circle_is_the_smallest(points: np.ndarray) -> None:
    circle = np.empty(3)
    enclosing_circle(np.ascontiguousarray(points), circle)
    centre, radius = circle[:2], circle[2]
    assert (np.linalg.norm(points - centre, axis=1) <= radius * (1.0 + 1e-12)).all()
    # The farthest points hold it: no step of the centre gets nearer to all of them.
    for angle in np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False):
        moved = centre + 1e-4 * radius * np.array([np.cos(angle), np.sin(angle)])
        assert np.linalg.norm(points - moved, axis=1).max() >= radius * (1.0 - 1e-9)
