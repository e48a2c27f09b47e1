"""The certificate of motions in time against dense samples of robot and obstacles."""

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.prove.certificate import certify, certify_moving
from guidefield.prove.verdict import Reason
from guidefield.scene.scene import Scene, build
from tests.robots import group, rest

PANDA = group("panda")
START = PANDA.chart(rest(PANDA))
END = START + np.array([1.2, 0.2, 0.0, 0.1, 0.0, 0.0, 0.0])
SWING = np.array([[START, START, END, END]])


def passing(since: float, until: float) -> Scene:
    """A ball flies through where the hand begins, and a bar that rests is far away."""
    flight = messages.ObstacleTrajectory(
        times=[since, until], placements=[Placement(position=(0.33, -1.5, 0.55)), Placement(position=(0.33, 1.5, 0.55))]
    )
    return build(
        messages.Scene(
            name="s",
            obstacles=[
                messages.Sphere(name="ball", radius=0.12, trajectory=flight),
                messages.Box(name="bar", size=(0.1, 0.1, 0.1), position=(-0.8, 0.0, 0.9)),
            ],
        )
    )


def worlds(scene: Scene) -> World:
    return World.build(PANDA, scene)


def sampled_free(scene: Scene, times: np.ndarray, clearance: float) -> bool:
    for s in np.linspace(0.0, 1.0, 120):
        share = 3.0 * s**2 - 2.0 * s**3
        world = World.build(PANDA, scene.at(times[0] + s * (times[1] - times[0])))
        q = PANDA.from_chart(START + share * (END - START))
        if contacts_at(world, q) or clearance_at(world, q).obstacle_distance < clearance:
            return False
    return True


@pytest.mark.parametrize(("since", "until"), [(0.0, 2.0), (0.5, 1.5), (2.0, 4.0), (-2.0, 0.1), (0.0, 30.0)])
@pytest.mark.parametrize("clearance", [0.0, 0.03])
def test_it_says_what_dense_samples_say(since: float, until: float, clearance: float) -> None:
    scene, times = passing(since, until), np.array([0.0, 2.0])
    verdict = certify(worlds(scene), SWING, clearance, times=times)
    assert verdict.free == sampled_free(scene, times, clearance)
    if not verdict.free:
        assert verdict.pair[1] == "ball"
        assert verdict.reason in (Reason.CONTACT, Reason.TOO_CLOSE)
        assert verdict.chart_point is not None


def test_waiting_is_a_motion_too() -> None:
    scene = passing(0.0, 2.0)
    still = np.repeat(START[None, None], 4, axis=1)
    assert not certify(worlds(scene), still, times=np.array([0.0, 2.0])).free
    assert certify(worlds(scene), still, times=np.array([2.0, 9.0])).free


def test_what_rests_is_judged_as_well_and_the_first_refusal_is_told() -> None:
    scene = passing(0.0, 40.0)
    blocked = build(
        messages.Scene(
            name="s",
            obstacles=[*scene.message.obstacles, messages.Sphere(name="rock", radius=0.1, position=(0.12, 0.31, 0.55))],
        )
    )
    verdict = certify(worlds(blocked), SWING, times=np.array([0.0, 2.0]))
    assert not verdict.free
    assert verdict.pair[1] == "rock"


def test_who_does_not_go_on_meets_nothing_that_is_endless() -> None:
    """As a guided path that begins at its goal."""
    times, placements = [0.0, 2.0], [Placement(position=(0.0, 0.0, height)) for height in (-2.0, -1.0)]
    flight = messages.ObstacleTrajectory(times=times, placements=placements)
    floor = messages.HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=0.0, trajectory=flight)
    scene = build(messages.Scene(name="s", obstacles=[floor]))
    assert certify_moving(worlds(scene), np.empty((0, 4, PANDA.nv)), np.array([0.5])).free
