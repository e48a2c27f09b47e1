"""Grids of cells: what they call apart or touching is so wherever in the cell; no answer depends on earlier ones."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.world import World
from guidefield.kernels.collide.layout import (
    CHILDREN,
    DIVIDED,
    GRID_NUMBERS,
    GRID_PLACES,
    GRID_SIDES,
    LEVELS,
    START,
    TOGETHER,
    BatchBodies,
)
from guidefield.kernels.collide.self_narrowphase import APART, TOUCHING, UNJUDGED, UNKNOWN
from guidefield.messages import scene as messages
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build
from tests.collision.batch.test_batch_collision import draw
from tests.robots import box_arm, group, grouped


def alone(planned: PlanningGroup) -> tuple[World, BatchCollision]:
    """A robot that only has itself, none of whose cells have been judged."""
    world = World.build(planned, build(messages.Scene(name="nothing")))
    batch = BatchCollision.build(world)
    unjudge(batch)
    return world, batch


def unjudge(batch: BatchCollision, capacity: int | None = None) -> None:
    """Forget all verdicts; leave a capacity for children of divided cells, by default all that there is."""
    cells, grids = batch.tables.bodies.cells, batch.tables.bodies.grids.reshape(-1, GRID_PLACES)
    counts = [row[1:START:3] >> row[LEVELS] * row[DIVIDED] for row in grids]
    ends = [
        row[TOGETHER] + np.prod(-(-count // (1 << row[DIVIDED])))
        for row, count in zip(grids, counts, strict=True)
        if row[1] > 0
    ]
    cells[:] = UNJUDGED
    batch.tables.bodies.apart[:] = 0
    cells[0] = max(ends, default=CHILDREN) if capacity is None else len(cells) - capacity


def judged(bodies: BatchBodies) -> dict[tuple[int, ...], int]:
    """The verdicts on judged cells, by link pair, divisions so far, and the cell's indices among such cells."""
    found = {}

    def look(link_pair: int, row: np.ndarray, at: int, divisions: int, indices: tuple[int, ...]) -> None:
        known = int(bodies.cells[at])
        if known == UNJUDGED:
            return
        found[link_pair, divisions, *indices] = min(known, TOUCHING + 1)
        if known > TOUCHING:
            for child in range(CHILDREN):
                steps = [child // stride % (1 << row[DIVIDED]) if stride else 0 for stride in row[2:START:3].tolist()]
                below = tuple((index << row[DIVIDED]) + step for index, step in zip(indices, steps, strict=True))
                look(link_pair, row, known + child, divisions + row[DIVIDED], below)

    for link_pair, row in enumerate(bodies.grids.reshape(-1, GRID_PLACES)):
        if row[1] > 0:
            counts = row[1:START:3] >> row[LEVELS] * row[DIVIDED]
            for cell in np.flatnonzero(bodies.cells[row[START] : row[START] + counts.prod()]).tolist():
                look(link_pair, row, row[START] + cell, 0, np.unravel_index(cell, counts))
    return found


def arm(name: str) -> PlanningGroup:
    return grouped(box_arm("x slide oblique continuous mimic y", 6)) if name == "boxes" else group(name)


def distance(world: World, z: np.ndarray, first: int, second: int) -> float:
    """Between two bodies, by Coal."""
    shapes = world.group.geometry.geometryObjects
    pin.forwardKinematics(world.model, world.data, world.group.expand_from_local(z))
    placed = []
    for index in (first, second):
        placement = world.data.oMi[shapes[index].parentJoint] * shapes[index].placement
        placed += [shapes[index].geometry, coal.Transform3s(placement.rotation, placement.translation)]
    return float(coal.distance(*placed, coal.DistanceRequest(), coal.DistanceResult()))


@pytest.mark.parametrize(("robot", "verdict"), [("panda", APART), ("boxes", APART), ("boxes", TOUCHING)])
def test_verdicts_hold_at_the_corners_of_cells(robot: str, verdict: int) -> None:
    world, batch = alone(arm(robot))
    batch.touching(draw(world.group, 400, 1))
    bodies, rng, seen = batch.tables.bodies, np.random.default_rng(0), set()
    grids, numbers = bodies.grids.reshape(-1, GRID_PLACES), bodies.grid_numbers.reshape(-1, GRID_NUMBERS)
    pairs, link_pairs = bodies.pairs.reshape(-1, 3), bodies.link_pairs.reshape(-1, 4)
    cells = [cell for cell, known in judged(bodies).items() if known == verdict]
    for chosen in rng.permutation(len(cells))[:100].tolist():
        link_pair, divisions, *indices = cells[chosen]
        places, row = grids[link_pair], numbers[link_pair].astype(float)
        corner = np.array(indices) + rng.integers(0, 2, GRID_SIDES)
        z = world.group.to_local(world.group.random(rng))  # any corner of the cell, any value of other coordinates
        for side in np.flatnonzero(row[1:-1:3] > 0.0):
            length = (1 << places[LEVELS] * places[DIVIDED] - divisions) / row[3 * side + 1]
            z[places[3 * side]] = row[3 * side] + corner[side] * length
        first, last = link_pairs[link_pair, 2:]
        distances = [distance(world, z, a, b) for a, b, _ in pairs[first:last].tolist()]
        assert min(distances) > 0.0 if verdict == APART else min(distances) <= 0.0
        seen.add(divisions)
    assert len(cells) > (80 if verdict == APART else 20)
    assert len(seen) > 1 or robot == "panda", "cells of several sizes"


@pytest.mark.parametrize("robot", ["panda", "ur5", "boxes"])
def test_answers_do_not_depend_on_what_was_asked_before(robot: str) -> None:
    world, batch = alone(arm(robot))
    zs = draw(world.group, 200, 2)
    first = batch.touching(zs)
    known = judged(batch.tables.bodies)
    np.testing.assert_array_equal(BatchCollision.build(world).touching(zs), first)
    assert judged(batch.tables.bodies) == known
    unjudge(batch)
    np.testing.assert_array_equal(batch.touching(zs[::-1]), first[::-1])
    assert judged(batch.tables.bodies) == known
    assert APART in known.values()
    assert UNKNOWN not in known.values() or robot != "panda"
