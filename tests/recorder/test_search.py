"""How the planner searched: trees edge by edge, where Pinocchio has the tip."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.planner.task.trace import GROWTH_STEPS, LoggedTrees
from guidefield.recorder import recorder
from tests.recorder.runs import MadeUp, grown_trees, made_up


@pytest.fixture(scope="module", params=["panda", "kinova"])
def run(request: pytest.FixtureRequest) -> MadeUp:
    return made_up(request.param)


def _tip(run: MadeUp, z: np.ndarray) -> np.ndarray:
    model = run.group.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, run.group.expand_from_chart(z))
    return np.array(data.oMf[model.getFrameId(run.group.tip)].translation)


def test_each_edge_of_a_tree_is_drawn_once_a_parent_before_its_children(run: MadeUp) -> None:
    trees = grown_trees(run.group)
    (chunk,) = recorder.trees(run.group, [(5, LoggedTrees(tuple(len(points) for points, _ in trees), tuple(trees)))])
    batch = chunk.to_record_batch()
    assert batch.column("step").to_pylist() == list(range(5, 5 + GROWTH_STEPS))
    rows = batch.column("LineStrips3D:strips").to_pylist()
    drawn = np.array([strip for row in rows for strip in row])
    expected = [
        [_tip(run, points[parent]), _tip(run, point)]
        for points, parents in trees
        for point, parent in zip(points, parents, strict=True)
        if parent >= 0
    ]
    assert drawn.shape == np.shape(expected)
    for edge in expected:
        assert np.isclose(drawn, edge, atol=1e-6).all(axis=(1, 2)).sum() == 1
    reached = [_tip(run, points[0]) for points, _ in trees] + [_tip(run, trees[1][0][1])]
    for start, end in drawn:
        assert min(np.linalg.norm(np.subtract(start, one)) for one in reached) < 1e-5
        reached.append(end)
