import numpy as np
import pytest

from guidefield.geometry.primitive_covers import inner_balls
from guidefield.geometry.solid import solid
from tests.geometry import solids

BODIES = {
    "box": solids.lying(solids.box((0.05, 0.08, 0.12))),
    "ring": solids.lying(solids.torus()),
    "channel": solids.channel(),
    "hollow": solids.hollow(),
    "overlapping": solids.overlapping(),
    "inside out": solids.turned(solids.channel()),
}


@pytest.mark.parametrize("name", BODIES)
def test_balls_are_inside_and_fill_much(name: str) -> None:
    mesh = BODIES[name]
    balls = inner_balls(solid(*mesh))
    assert 4 <= len(balls) <= 8
    assert not balls.flags.writeable
    assert (np.abs(solids.winding(balls[:, :3], mesh)) > 0.5).all()
    rng = np.random.default_rng(0)
    on_balls = solids.around(balls, 100, rng).reshape(-1, 3)
    assert (np.abs(solids.winding(on_balls, mesh)) > 0.5).all()
    points = solids.in_box_of(mesh, 1500, rng)
    inside = points[np.abs(solids.winding(points, mesh)) > 0.5]
    assert solids.in_balls(inside, balls).mean() > (0.4 if name == "ring" else 0.2)


@pytest.mark.parametrize("mesh", [solids.torus(), solids.channel(), solids.hollow()], ids=["ring", "channel", "hollow"])
def test_balls_are_as_far_from_the_surface_as_they_are_large(mesh: solids.Mesh) -> None:
    balls = inner_balls(solid(*mesh))
    assert (balls[:, 3] < solids.distance(balls[:, :3], mesh)).all()


@pytest.mark.parametrize(
    "mesh",
    [solids.bowl(), solids.cracked(), solids.together(solids.bowl(), solids.turned(solids.bowl()))],
    ids=["open", "cracked", "sheet"],
)
def test_there_are_none_where_nothing_is_known_to_be_inside(mesh: solids.Mesh) -> None:
    assert inner_balls(solid(*mesh, widest_gap=0.02)).shape == (0, 4)
