"""Certificates of motions in time, and with a tube, against dense samples of robot, obstacles and boxes."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.messages import requests, scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.prove.certificate import certify, certify_constraints, certify_moving
from guidefield.prove.closest import world_at
from guidefield.prove.verdict import Reason
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames
from guidefield.scene.scene import Scene, build
from tests.collision.plain import dense
from tests.planner.problems import scene_of
from tests.planner.test_moving_kinds import moving
from tests.prove.test_certificate import motions, strewn
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


def beside(rng: np.random.Generator, points: np.ndarray, half: np.ndarray, count: int) -> np.ndarray:
    """Corners of the boxes about points (n, nv), and places in them."""
    shape = (count, *points.shape)
    corners = rng.choice([-1.0, 1.0], shape)
    return np.concatenate([points + half * corners, points + half * rng.uniform(-1.0, 1.0, shape)]).reshape(
        -1, points.shape[1]
    )


@settings(max_examples=8)
@given(st.integers(0, 2), st.integers(0, 10**6), st.sampled_from([0.003, 0.02, 0.06]))
def test_a_certified_tube_is_free_wherever_one_looks(place, seed, width):
    world, judge = strewn(place)
    rng, control = np.random.default_rng(seed), motions(world, seed)
    half = width * rng.uniform(0.0, 1.0, world.group.nv)
    verdict = certify(world, control[None], tube=half[None])
    alone = certify(world, control[None])
    assert alone.free or not verdict.free
    samples = dense(control, 0.05)
    if verdict.free:
        assert not any(judge.collides(q) for q in beside(rng, samples, half, 4))
    elif alone.free:
        assert verdict.reason is Reason.UNDECIDED
        piece, until = verdict.free_until
        assert piece == 0
        before = samples[: int(until * (len(samples) - 1)) + 1]
        assert until == 0.0 or not any(world.in_collision(q) for q in beside(rng, before, half, 4))


def test_without_a_width_a_tube_changes_nothing():
    world, _ = strewn(0)
    for seed in range(8):
        control = motions(world, seed)
        one, other = (certify(world, control[None], tube=tube) for tube in (None, np.zeros((1, world.group.nv))))
        assert (one.reason, one.place, one.free_until, one.evaluations) == (
            other.reason,
            other.place,
            other.free_until,
            other.evaluations,
        )


def test_what_comes_closer_the_wider_the_tube_is_refused():
    world, _ = strewn(1)
    control = motions(world, 0)
    free = [certify(world, control[None], tube=np.full((1, world.group.nv), width)).free for width in (1e-4, 2.0)]
    assert free == [certify(world, control[None]).free, False]


@settings(max_examples=6)
@given(st.integers(0, 2), st.integers(0, 10**6), st.integers(3, 60))
def test_certified_steps_are_free_in_the_boxes_between_commands(place, seed, count):
    world, judge = strewn(place)
    rng, way = np.random.default_rng(seed), dense(motions(world, seed), 1e-3)
    commands = way[np.linspace(0, len(way) - 1, count).astype(int)]
    motion = SubmittedMotion(CurveKind.STEPS, commands, np.arange(count), 0.1 * np.arange(count))
    verdict = certify(world, motion.pieces, times=motion.times, tube=motion.tube)
    if verdict.free:
        for first, second in itertools.pairwise(commands):
            inside = first + rng.integers(0, 2, (6, world.group.nv)) * (second - first)
            assert not any(judge.collides(q) for q in inside)
    else:
        assert verdict.piece is not None


@pytest.mark.parametrize("width", [0.0, 0.02])
def test_a_path_constraint_is_kept_in_the_tube(width):
    arm, rng = group("panda"), np.random.default_rng(3)
    start = rest(arm)
    control = np.stack([start, start + 0.05 * rng.normal(size=arm.nv)])[None]
    tip, z = arm.robot.tip, np.eye(3)[2]
    pointing = ConstrainedFrames(arm, (Cone(tip, z, z, 3.0),)).placements(start)[0].rotation[:, 2]
    verdicts, half = [], np.full((1, arm.nv), width)
    for angle in (0.01, 0.5):
        frames = ConstrainedFrames(arm, (Cone(tip, z, pointing, angle),))
        verdict = certify_constraints(frames, strewn(0)[0].bodies.turns, control, tube=half)
        verdicts.append(verdict.free)
        if verdict.free:
            for z in beside(rng, dense(control[0], 0.02), half[0], 20):
                assert (frames.values(z) <= frames.limits + 1e-9).all()
    assert verdicts[1]
    assert verdicts[0] is False


def test_an_execution_has_the_ticks_of_its_holds():
    with pytest.raises(ValueError, match="needs the `rate` of its ticks"):
        requests.ExecutionOptions("zero_order_hold")


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.booleans())
def test_a_tube_is_free_of_what_moves_at_each_time(seed, steps):
    rng = np.random.default_rng(seed)
    scene = scene_of(moving("box", "box", rng, 0.2, 2.0))
    world = World.build(group("panda"), scene)
    way = dense(motions(world, seed), 1e-3)
    times = np.linspace(0.0, 2.0, 30)
    points = way[np.linspace(0, len(way) - 1, len(times)).astype(int)]
    kind = CurveKind.STEPS if steps else CurveKind.LINEAR
    motion = SubmittedMotion(kind, points, np.arange(len(times)), times, tolerance=np.full(world.group.nv, 0.01))
    verdict = certify(world, motion.pieces, times=times, tube=motion.tube)
    if verdict.free:
        for piece, tube, begin, end in zip(motion.pieces, motion.tube, times, times[1:], strict=False):
            for share in rng.uniform(0.0, 1.0, 3):
                now = world_at(world, begin + share * (end - begin))
                inside = beside(rng, (piece[:1] + share * (piece[1:] - piece[:1])), tube, 2)
                assert not any(now.in_collision(world.group.expand_from_chart(z)) for z in inside)
    else:
        assert verdict.free_until is not None
