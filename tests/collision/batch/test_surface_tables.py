"""Tables of large surfaces: boxes about large nodes hold all that is below these."""

from pathlib import Path

import numpy as np
import pytest

from guidefield.collision.batch.surface_tables import large_surface
from guidefield.geometry import cache
from guidefield.geometry.convex import CLUSTERS, count_boxed
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, KIND, LINK, OWN, PART, POLYTOPE, SHAPE
from guidefield.kernels.jit.cache import cache_folder
from guidefield.kernels.simd.vector import LANES
from guidefield.messages import scene as messages
from guidefield.scene.scene import build
from tests.geometry import solids
from tests.scene.solids import mesh_message


@pytest.fixture(autouse=True)
def _large(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "LARGE", 1)


SOLIDS = {
    "ring": solids.torus(0.8, 0.1, 100, 40),
    "thin": solids.lying(solids.torus(0.3, 1e-3, 300, 6), 1),
    "far": (solids.torus(0.8, 0.1, 60, 40)[0] + [90.0, -70.0, 40.0], solids.torus(0.8, 0.1, 60, 40)[1]),
    "tiny": (solids.torus(8e-4, 1e-4, 60, 40)[0], solids.torus(8e-4, 1e-4, 60, 40)[1]),
}


@pytest.mark.parametrize("mesh", SOLIDS.values(), ids=SOLIDS)
def test_boxes_hold_what_is_below_their_nodes(mesh: solids.Mesh) -> None:
    (obstacle,) = build(messages.Scene(name="s", obstacles=[mesh_message(*mesh)])).obstacles
    made = large_surface(obstacle)
    links, shapes = made["links"].reshape(-1, LINK), made["shapes"].reshape(-1, SHAPE)
    vertices, corners = made["vertices"].reshape(-1, 3, LANES), made["numbers"].reshape(-1, PART)[:, :9]
    ways = np.random.default_rng(0).normal(size=(60, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    boxed = 0
    for node in np.flatnonzero((links[:, 0] >= 0) & (links[:, OWN] >= 0)).tolist():
        kind, first, blocks = shapes[links[node, OWN], [KIND, FIRST_BLOCK, BLOCKS]].tolist()
        waiting, below = [node], list[int]()
        while waiting:
            left, right, own = links[waiting.pop()].tolist()
            below += [own] if left < 0 else []
            waiting += [] if left < 0 else [left, right]
        assert kind == POLYTOPE
        if len(below) <= CLUSTERS[-1]:
            continue
        boxed += 1
        box = vertices[first : first + blocks].swapaxes(1, 2).reshape(-1, 3).astype(float)
        held = corners[below].reshape(-1, 3)
        assert ((box @ ways.T).max(axis=0) >= (held @ ways.T).max(axis=0)).all()
        assert np.ptp(box, axis=0).max() < 3.0 * np.ptp(held, axis=0).max() + 1e-3, "it is no larger than it has to be"
    assert boxed == count_boxed(obstacle.faces) > 0
