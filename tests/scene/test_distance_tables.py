"""The rows of primitives, made many at once, are those of their Coal shapes; what each belongs to is kept."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.distance_bodies import primitive
from guidefield.kernels.distance.distance import HALF_SPACE
from guidefield.messages import scene as messages
from guidefield.scene.distance_tables import bodies_of, distance_tables
from guidefield.scene.scene import build

KINDS = ("box", "sphere", "cylinder", "capsule", "half_space", "mesh")


def obstacle(rng: np.random.Generator, kind: str, name: str) -> messages.Obstacle:
    place, turn = rng.uniform(-2.0, 2.0, 3), rng.normal(size=4)
    a, b = rng.uniform(0.02, 0.4, 2).tolist()
    position = (float(place[0]), float(place[1]), float(place[2]))
    x, y, z, w = (turn / np.linalg.norm(turn)).tolist()
    placed = {"position": position, "quaternion_xyzw": (x, y, z, w)}
    match kind:
        case "box":
            return messages.Box(name=name, size=(a, b, 0.3), **placed)
        case "sphere":
            return messages.Sphere(name=name, radius=a, position=position)
        case "cylinder":
            return messages.Cylinder(name=name, radius=a, length=b, **placed)
        case "capsule":
            return messages.Capsule(name=name, radius=a, length=b, **placed)
        case "half_space":
            return messages.HalfSpace(name=name, normal=position, offset=a)
    corners = [(0.0, 0.0, 0.0), (a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, a)]
    return messages.Mesh(name=name, vertices=corners, triangles=[(0, 1, 2), (0, 2, 3)], **placed)


@pytest.mark.parametrize("count", [1, 5, 70])
@pytest.mark.parametrize("chosen", [KINDS, KINDS[:4], KINDS[4:], ("box",), ("half_space",)])
def test_rows_are_those_of_coals_shapes(chosen: tuple[str, ...], count: int) -> None:
    rng = np.random.default_rng(count)
    kinds = rng.choice(chosen, count).tolist()
    scene = build(messages.Scene("s", obstacles=[obstacle(rng, kind, f"o{k}") for k, kind in enumerate(kinds)]))
    tables = distance_tables(scene)
    assert sorted(tables.obstacles.tolist()) == list(range(count))
    endless = tables.kinds == HALF_SPACE
    assert (np.diff(endless.astype(int)) <= 0).all()  # half-spaces first
    assert (np.diff(tables.obstacles[endless]) > 0).all()
    for row, owner in enumerate(tables.obstacles.tolist()):
        one = scene.obstacles[owner]
        if kinds[owner] == "mesh":
            assert tables.spans[row, 3] == 2
            continue
        body = primitive(one.shape)
        assert body is not None
        body = body.place(one.placement.rotation, one.placement.translation)
        assert tables.kinds[row] == body.kind
        np.testing.assert_allclose(tables.sizes[row], body.size, rtol=1e-15)
        np.testing.assert_allclose(tables.bounds[row], body.bounds, rtol=1e-15)
        np.testing.assert_allclose(tables.placements[row], body.placement, atol=1e-15)
        assert tables.spans[row].tolist() == [0, 0, 0, 0, 0]
    assert not any(array.flags.writeable for array in tables[:7])


def test_boxes_about_slanted_polygons_are_as_thin_as_these() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        flat = np.column_stack([[-0.3, 0.3, 0.2, -0.1], [0.0, 0.0, 0.5, 0.5], np.zeros(4)])
        corners = flat @ turn.T + [1.0, 2.0, 0.5]
        vertices = [(float(x), float(y), float(z)) for x, y, z in corners]
        polygon = messages.Polygon(name="p", vertices=vertices)
        (body,) = bodies_of(build(messages.Scene("s", obstacles=[polygon])).obstacles[0])
        extents = np.sort(body.bounds[3:] - body.bounds[:3])
        np.testing.assert_allclose(extents, [0.0, 0.5, 0.6], atol=1e-12)
        a, u, w = np.split(body.surface.corners, 3, axis=1)
        placed = np.concatenate([a, a + u, a + w]) @ body.placement[:, :3].T + body.placement[:, 3]
        apart = np.linalg.norm(placed[:, None] - corners, axis=2)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-12, "each is a corner, and each is there"
