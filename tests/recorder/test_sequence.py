"""The recording of a sequence: the object is carried."""

import json

import numpy as np
import pytest

from guidefield.engine import Engine
from guidefield.messages.replies import PlanReply
from tests.examples import example
from tests.recorder.runs import Recording


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanReply, Recording]:
    """The can is picked up, lifted, and put down in the air."""
    request = json.loads(example("kitchen"))
    request["steps"] = request["steps"][:4]
    request["steps"][3]["detach"] = "can"
    request |= {"allowed_planning_time": 120.0, "recording": "summary"}
    path = tmp_path_factory.mktemp("sequence") / "run.rrd"
    reply = Engine().answer(request, record_to=path)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.recording == str(path)
    return reply, Recording(path)


def test_the_object_rests_until_it_is_picked_up_and_is_carried_then(carried: tuple[PlanReply, Recording]) -> None:
    reply, recording = carried
    entity = "/obstacles/single/can"
    times = recording.times(entity, "path_time")
    moved = np.array(recording.values(entity, "Transform3D:translation", "path_time")).reshape(-1, 3)
    lifting = reply.steps[3]
    assert np.abs(moved[times <= lifting.begin]).max() < 1e-6
    np.testing.assert_allclose(moved[-1], (0.0, 0.0, 0.04), atol=1e-3)
    assert (np.diff(moved[times >= lifting.begin][:, 2]) > -1e-6).all()
