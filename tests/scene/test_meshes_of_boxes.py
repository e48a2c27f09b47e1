"""Meshes that are made of boxes, as boxes for the kernels; and the faces of meshes as quadrilaterals for the field."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.geometry.charged import field_tables, pair_faces
from guidefield.geometry.mesh_surface import find_boxes
from guidefield.kernels.distance.distance import BOX, SOLID, distance_at_points
from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import build
from tests.geometry import solids

SIZES = ((0.3, 0.2, 0.1), (0.2, 0.2, 0.2), (2.0, 1e-3, 0.5), (1e-2, 30.0, 1e-2))


def placed(mesh: solids.Mesh, rng: np.random.Generator, far: float = 1.0) -> solids.Mesh:
    """A mesh turned and moved anywhere."""
    rotation = pin.Quaternion(*rng.normal(size=4)).normalized().matrix()
    return mesh[0] @ rotation.T + far * rng.normal(size=3), mesh[1]


@pytest.mark.parametrize("size", SIZES)
def test_a_box_is_found_however_it_stands(size: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        vertices, triangles = placed(solids.box(size), rng)
        (found,) = find_boxes(vertices, [triangles[rng.permutation(12)]])
        assert np.allclose(np.sort(2.0 * found.halves), np.sort(size), rtol=1e-9)
        own = (vertices - found.centre) @ found.rotation
        assert (np.abs(own) <= found.halves + 1e-12).all()
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_what_has_eight_corners_and_is_no_box_is_none() -> None:
    vertices, triangles = solids.box((0.3, 0.2, 0.1))
    for change in ("corner", "sheared", "tapered", "dented"):
        changed = vertices.copy()
        if change == "corner":
            changed[0, 0] += 1e-5
        elif change == "sheared":
            changed[:, 0] += 0.01 * changed[:, 1]
        elif change == "tapered":
            changed[changed[:, 2] > 0.0, :2] *= 0.9
        else:
            changed[0] = 0.0
        assert find_boxes(changed, [triangles]) == [None], change


def test_distances_from_a_mesh_of_boxes_are_those_from_the_boxes() -> None:
    rng = np.random.default_rng(5)
    meshes = [placed(solids.box(size), rng, 0.4) for size in SIZES[:2]]
    wedge = solids.box((0.2, 0.1, 0.3))
    wedge[0][wedge[0][:, 2] > 0.0, 0] *= 0.5
    vertices, triangles = solids.together(*meshes, placed(wedge, rng, 0.4))
    named = {"vertices": vertices.tolist(), "triangles": triangles.tolist()}
    one = distance_tables(build(messages.Scene(name="one", obstacles=[messages.Mesh(name="all", **named)])))
    each = [
        messages.Mesh(name=f"{k}", vertices=some.tolist(), triangles=faces.tolist())
        for k, (some, faces) in enumerate([*meshes, (vertices[16:], triangles[24:] - 16)])
    ]
    several = distance_tables(build(messages.Scene(name="several", obstacles=each)))
    assert sorted(one.kinds) == sorted(several.kinds) == [BOX, BOX, SOLID]
    points = rng.uniform(-1.0, 1.0, (500, 3))
    found, expected = distance_at_points(one, points), distance_at_points(several, points)
    assert np.allclose(found[0], expected[0], atol=1e-12)


@pytest.mark.parametrize("shape", ["box", "channel", "torus"])
def test_the_field_of_paired_faces_is_that_of_the_triangles(shape: str) -> None:
    rng = np.random.default_rng(11)
    mesh = {"box": solids.box((0.3, 0.2, 0.1)), "channel": solids.channel(), "torus": solids.torus()}[shape]
    vertices, triangles = placed(mesh, rng)
    quads, rest = pair_faces(vertices, triangles)
    assert 2 * len(quads) + len(rest) == len(triangles)
    assert len(quads) >= {"box": 6, "channel": 12, "torus": 0}[shape]
    points = vertices.mean(axis=0) + rng.normal(scale=0.3, size=(200, 3))
    paired = field_at_points(field_tables(rest, quads=quads), points)
    expected = field_at_points(field_tables(vertices[triangles]), points)
    for value, other in zip(paired, expected, strict=True):
        assert np.allclose(value, other, rtol=1e-9, atol=1e-9)
