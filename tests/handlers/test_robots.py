"""What is said about a robot's shapes."""

from guidefield.handlers.robots import robot as described
from guidefield.robot.link_bounds import convex_parts, coverage
from tests.robots import robot


def test_shapes_come_with_their_cover_and_parts() -> None:
    model = robot("ur5")
    covered, cut = coverage(model), convex_parts(model)
    reply = described(model)
    assert [shape.name for shape in reply.geometry] == [choice.name for choice in model.geometry_choices]
    for shape, balls, found in zip(reply.geometry, covered.shapes, cut, strict=True):
        assert (shape.cover.spheres, shape.cover.inner_balls) == (len(balls.cover.spheres), len(balls.inner))
        assert shape.cover.overhang == balls.cover.overhang <= covered.delta
        assert (shape.parts is None) == (found is None) == (shape.judged_as != "triangle mesh")
        if shape.parts is not None and found is not None:
            assert shape.parts.count == len(found.parts)
            assert shape.parts.stand_off == max(part.stand_off for part in found.parts)
