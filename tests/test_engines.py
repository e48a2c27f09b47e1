"""Each user has runs, scenes and robots of its own; others see what is shared, operators everything.

Between queries a worker goes on with what a plan had no time for, until the next query.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from guidefield import engines as module
from guidefield.engines import Engines
from guidefield.errors import GuidefieldError, NotAllowed, QuotaExceeded, RobotInvalid, SceneInvalid, UnknownObject
from guidefield.memory import Limit
from guidefield.messages import requests
from guidefield.messages.identities import PLAIN, Quota, Quotas
from guidefield.messages.replies import ClearanceReply
from guidefield.messages.scene import Scene, Sphere
from guidefield.messages.streams import StreamOpen, StreamUpdate
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Task
from guidefield.stores import by_user
from guidefield.stores.by_user import Kind, StoresByUser
from guidefield.stores.runs import RunDatabase
from guidefield.stream.journal import Journal
from tests import worker_setups
from tests.kept_runs import begin

URDF = """<robot name="{}"><link name="a"/>
  <link name="b"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""
REQUEST = requests.PlanRequest(robot="ur5", scene="table", goal=requests.JointsGoal(positions={}))


@pytest.fixture
def engines(tmp_path: Path) -> Iterator[Engines]:
    database = RunDatabase(tmp_path)
    engines = Engines("cell", StoresByUser(tmp_path, database=database))
    for user, radius in (("alice", 0.1), ("bob", 0.2), (PLAIN, 0.3)):
        ball = Scene("ball", obstacles=[Sphere(name="s", radius=radius, position=(0.0, 0.0, 1.0))])
        engines.answer(user, user, requests.StoreScene("ball", ball))
        engines.answer(user, user, requests.StoreRobot("mine", requests.RobotFiles(URDF.format(user))))
        begin(database, f"{user}-run", REQUEST, user)
    yield engines
    database.close()


def _radius(engines: Engines, user: str, scene: str) -> float:
    """As the plan of a user would see it: by the exact distance of a robot's link from the ball in it."""
    asked = requests.Potential(scene=scene, points=[(0.0, 0.0, 3.0)])
    read = engines.of(user)._find_scene_message(asked.scene)
    (ball,) = read.obstacles
    return ball.radius


def test_the_same_name_is_each_users_own(engines: Engines) -> None:
    for user, radius in (("alice", 0.1), ("bob", 0.2), (PLAIN, 0.3)):
        reply = engines.answer(user, user, requests.ReadScene("ball"))
        (ball,) = reply.scene.obstacles
        assert ball.radius == radius == _radius(engines, user, "ball")
        robot = engines.answer(user, user, requests.ReadRobot("mine"))
        assert (robot.name, len(robot.joints)) == ("mine", 1)
    engines.answer("bob", "bob", requests.DeleteScene("ball"))
    with pytest.raises(SceneInvalid, match="no scene 'ball'"):
        engines.answer("bob", "bob", requests.ReadScene("ball"))
    assert _radius(engines, "alice", "ball") == 0.1


def test_lists_have_ones_own_and_what_is_shared_and_an_operators_everything(engines: Engines) -> None:
    engines.share("alice", "scenes", "ball", shared=True)
    engines.share("bob", "robots", "mine", shared=True)
    engines.share("alice", "runs", "alice-run", shared=True)
    expected = {
        "alice": ({"ball"}, {"mine", "bob:mine"}, {"alice-run"}),
        "bob": ({"ball", "alice:ball"}, {"mine"}, {"bob-run", "alice:alice-run"}),
        "carol": ({"alice:ball"}, {"bob:mine"}, {"alice:alice-run"}),
        PLAIN: (
            {"ball", "alice:ball", "bob:ball"},
            {"mine", "alice:mine", "bob:mine"},
            {"plain-run", "alice:alice-run", "bob:bob-run"},
        ),
    }
    for user, (scenes, robots, runs) in expected.items():
        listed = engines.answer(user, user, requests.ReadScenes())
        assert {name for name in listed.scenes if name.endswith("ball")} == scenes
        known = engines.answer(user, user, requests.ReadRobots())
        assert {robot.name for robot in known.robots if robot.name.endswith("mine")} == robots
        kept = engines.answer(user, user, requests.ReadRuns())
        assert {run.run_id for run in kept.runs} == runs


@pytest.mark.parametrize("kind", ["runs", "scenes", "robots"])
def test_nobody_may_do_anything_with_what_is_anothers_but_operators(kind: Kind, engines: Engines) -> None:
    name = {"runs": "alice-run", "scenes": "ball", "robots": "mine"}[kind]
    right = engines.stores.require_right
    for there in (name, "nothing"):
        for read_only in (True, False):
            with pytest.raises(NotAllowed, match="belongs to user 'alice', who") as refused:
                right("bob", "alice", kind, there, read_only=read_only)
            assert refused.value.details == {"user": "alice", "kind": kind, "name": there}
            right(PLAIN, "alice", kind, there, read_only=read_only)
            right("alice", "alice", kind, there, read_only=read_only)
    engines.share("alice", kind, name, shared=True)
    right("bob", "alice", kind, name, read_only=True)
    with pytest.raises(NotAllowed, match="alone may change it"):
        right("bob", "alice", kind, name, read_only=False)
    engines.share("alice", kind, name, shared=False)
    with pytest.raises(NotAllowed, match="doesn't share it"):
        right("bob", "alice", kind, name, read_only=True)


def test_a_request_may_name_what_another_user_shares(engines: Engines) -> None:
    asked = requests.Clearance(robot="bob:mine", scene="alice:ball", configurations=[{}])
    with pytest.raises(NotAllowed, match="robot 'mine' belongs to user 'bob'"):
        engines.answer("carol", "carol", asked)
    engines.share("bob", "robots", "mine", shared=True)
    with pytest.raises(NotAllowed, match="scene 'ball' belongs to user 'alice'"):
        engines.answer("carol", "carol", asked)
    engines.share("alice", "scenes", "ball", shared=True)
    assert isinstance(engines.answer("carol", "carol", asked), ClearanceReply)
    assert _radius(engines, "carol", "alice:ball") == 0.1
    assert _radius(engines, PLAIN, "bob:ball") == 0.2


def test_what_is_stored_again_after_it_was_deleted_is_not_shared(engines: Engines) -> None:
    things: list[tuple[Kind, str, requests.Request]] = [
        ("scenes", "ball", requests.DeleteScene("ball")),
        ("robots", "mine", requests.DeleteRobot("mine")),
        ("runs", "alice-run", requests.DeleteRun("alice-run")),
    ]
    for kind, name, deleting in things:
        engines.share("alice", kind, name, shared=True)
        engines.answer("alice", "alice", deleting)
        assert not engines.stores.may_read("bob", "alice", kind, name)


@pytest.mark.parametrize(
    ("kind", "error"), [("runs", UnknownObject), ("scenes", SceneInvalid), ("robots", RobotInvalid)]
)
def test_only_what_there_is_can_be_shared(kind: Kind, error: type[GuidefieldError], engines: Engines) -> None:
    with pytest.raises(error, match="'nothing'"):
        engines.share("alice", kind, "nothing", shared=True)


def test_a_users_room_is_bounded_and_others_have_theirs(tmp_path: Path) -> None:
    engines = Engines("cell", StoresByUser(tmp_path, quotas=Quotas(users={"alice": Quota(bytes=1_000)})))
    scene = Scene("ball", obstacles=[Sphere(name="s", radius=0.1)])
    engines.answer("alice", "alice", requests.StoreScene("ball", scene), size=500)
    with pytest.raises(QuotaExceeded, match=r"take \d+ bytes and may take 1000; delete some"):
        engines.answer("alice", "alice", requests.StoreScene("ball", scene), size=990)
    engines.answer("bob", "bob", requests.StoreScene("ball", scene), size=990)
    engines.answer("alice", "alice", requests.DeleteScene("ball"))
    engines.answer("alice", "alice", requests.StoreScene("ball", scene), size=990)


def test_users_that_have_something_stored_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_user, "MOST_USERS", 2)
    monkeypatch.setattr(by_user, "OPEN_STORES", Limit(1, 0))
    stores = StoresByUser(tmp_path)
    for user in ("alice", "bob", "alice", PLAIN):
        stores.of(user)
    with pytest.raises(QuotaExceeded, match="2 users have something stored already"):
        stores.of("carol")
    assert stores.users() == ["alice", "bob"]


def test_a_streams_recording_that_is_too_large_is_told_with_the_way_to_have_it(engines, monkeypatch):
    asked = StreamOpen("ur5", "table")
    journal = Journal(engines.stores.streams_of("alice") / "s", asked, "alice", {})
    with engines.of("alice").stream(asked, None, journal) as stream:
        stream.update(StreamUpdate(0.0))
    journal.close()
    size = len(engines.stream_recording("alice", "s"))
    monkeypatch.setattr(module, "LARGEST_RECORDING", 2 * size)  # each time it is made it has a few bytes more or less
    assert engines.stream_recording("alice", "s").startswith(b"RRF2")
    monkeypatch.setattr(module, "LARGEST_RECORDING", 1000)
    with pytest.raises(
        UnknownObject, match=r"at most 1000 are sent: at the service `guidefield runs export s stream.rrd`"
    ):
        engines.stream_recording("alice", "s")


PATIENCE = 60.0


@pytest.mark.parametrize("asked_again", [False, True])
def test_a_preparation_goes_on_until_the_next_query(asked_again: bool, tmp_path: Path) -> None:
    (parts := tmp_path / "parts").touch()
    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    try:
        assert pool.submit(Task(("go_on", str(parts)), PATIENCE)).result(PATIENCE) == (True, b"goes on")
        if asked_again:
            time.sleep(0.1)
            assert pool.submit(Task(("echo", "next"), PATIENCE)).result(PATIENCE) == (True, b"next")
            done = len(parts.read_bytes())
            assert done < 30
            time.sleep(0.1)
            assert len(parts.read_bytes()) == done
        else:
            until = time.monotonic() + PATIENCE
            while len(parts.read_bytes()) < 30 and time.monotonic() < until:
                time.sleep(0.02)
            assert len(parts.read_bytes()) == 30
    finally:
        pool.close(0.0)
