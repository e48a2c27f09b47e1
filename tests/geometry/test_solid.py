import numpy as np
import pytest

from guidefield.geometry.solid import solid
from tests.geometry import solids

CLOSED = {
    "box": solids.box((0.1, 0.2, 0.3)),
    "ring": solids.torus(),
    "channel": solids.lying(solids.channel()),
    "hollow": solids.hollow(),
    "inside out": solids.turned(solids.hollow()),
}


@pytest.mark.parametrize("mesh", CLOSED.values(), ids=CLOSED)
def test_depth_is_the_distance_to_the_surface(mesh: solids.Mesh) -> None:
    body = solid(*mesh)
    assert body.closed
    points = solids.in_box_of(mesh, 1000, np.random.default_rng(0))
    inside = np.abs(solids.winding(points, mesh)) > 0.5
    expected = np.where(inside, 1.0, -1.0) * solids.distance(points, mesh)
    assert body.depths(points) == pytest.approx(expected, abs=1e-12)
    assert body.distances(points) == pytest.approx(np.abs(expected), abs=1e-12)


def test_where_solids_overlap_the_deeper_one_counts() -> None:
    first, second = solids.box((0.1, 0.06, 0.06)), solids.box((0.06, 0.1, 0.05), (0.05, 0.03, 0.0))
    body = solid(*solids.together(first, second))
    assert len(body.spans) == 2
    points = solids.in_box_of(solids.overlapping(), 1500, np.random.default_rng(1))
    signed = [
        np.where(solids.winding(points, part) > 0.5, 1.0, -1.0) * solids.distance(points, part)
        for part in (first, second)
    ]
    assert body.depths(points) == pytest.approx(np.maximum(*signed), abs=1e-12)


def test_a_piece_inside_out_in_nothing_is_a_solid() -> None:
    mesh = solids.together(solids.box((0.2, 0.2, 0.2)), solids.turned(solids.box((0.1, 0.1, 0.1), (0.5, 0.0, 0.0))))
    body = solid(*mesh)
    assert len(body.spans) == 2
    assert body.depths(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.3, 0.0, 0.0]])) == pytest.approx(
        [0.1, 0.05, -0.15]
    )


def test_a_crack_is_closed_if_it_may_be() -> None:
    mesh = solids.cracked()
    centre = np.zeros((1, 3))
    open_body, closed_body = solid(*mesh, widest_gap=0.001), solid(*mesh, widest_gap=0.02)
    assert not open_body.closed
    assert open_body.lids == 0
    assert open_body.depths(centre)[0] == pytest.approx(-solids.distance(centre, mesh)[0])
    assert closed_body.closed
    assert closed_body.lids >= 2
    assert closed_body.depths(centre)[0] == pytest.approx(solids.distance(centre, mesh)[0], rel=1e-2)
    assert len(closed_body.owners) == len(mesh[1]) + closed_body.lids


def test_an_open_surface_has_no_inside() -> None:
    mesh = solids.bowl()
    body = solid(*mesh, widest_gap=0.02)
    assert not body.closed
    points = solids.in_box_of(mesh, 300, np.random.default_rng(0))
    assert body.depths(points) == pytest.approx(-solids.distance(points, mesh), abs=1e-12)


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [(np.zeros((3, 3)), np.array([[0, 1, 2]])), (np.outer(np.arange(3.0), [1, 1, 1]), np.array([[0, 1, 2]]))],
    ids=["point", "line"],
)
def test_what_has_no_area_is_refused(vertices: np.ndarray, triangles: np.ndarray) -> None:
    with pytest.raises(ValueError, match="area"):
        solid(vertices, triangles)
