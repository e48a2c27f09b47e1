"""The certificate: what it calls free is free under dense sampling, in time too; what touches is refused."""

import functools
import itertools
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.messages import requests, scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.prove import search
from guidefield.prove.certificate import certify, certify_constraints, certify_moving, motion_free
from guidefield.prove.closest import world_at
from guidefield.prove.curve import Curve
from guidefield.prove.search import SearchQuery
from guidefield.prove.verdict import COAL_ACCURACY, COAL_RELATIVE, Reason, with_coal_error
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames
from guidefield.scene.scene import Scene, build
from tests.collision.plain import dense, panda_among
from tests.collision.scenery import box, panda_in, scattered, world_of
from tests.collision.test_world import pair_distances
from tests.planner.problems import scene_of
from tests.planner.test_moving_kinds import moving
from tests.robots import box_arm, group, grouped, rest
from tests.scene.solids import l_prism, mesh_message

FINGER = 0.001  # where the Panda's fingers stand in its rest configuration [m]

STEP = 5e-3  # spacing of samples that judge a motion [rad or m]


@functools.cache
def plain(name: str):
    return panda_among(panda_in(name).scene.message.obstacles, FINGER)


@functools.cache
def strewn(seed: int):
    """A Panda among small obstacles of all primitive kinds, free at rest; and the plain judge."""
    rng = np.random.default_rng(seed)
    arm = group("panda")
    obstacles = [o for o in scattered(rng, 14) if not world_of(arm, [o]).in_collision(rest(arm))]
    obstacles.append(messages.HalfSpace(name="floor", normal=(0, 0, 1), offset=-0.02))
    return world_of(arm, obstacles), panda_among(obstacles, FINGER)


def motions(world, seed: int) -> np.ndarray:
    """A Bezier curve of degree 1 to 4 in local coordinates: short about the rest configuration, or long anywhere."""
    rng = np.random.default_rng(seed)
    planned = world.group
    start = rest(planned) if rng.random() < 0.7 else planned.random(rng)
    spread = rng.choice([0.1, 0.4, 1.2])
    steps = rng.normal(size=(int(rng.integers(2, 6)), planned.nv)) * spread / 3
    return np.clip(start + np.cumsum(steps, axis=0) - steps[0], planned.lower, planned.upper)


@settings(max_examples=12)  # `tools/doubt` looks at hundreds
@given(st.integers(0, 3), st.integers(0, 10**6))
def test_a_certified_motion_is_free_wherever_one_looks(place, seed):
    world, judge = strewn(place) if place < 3 else (panda_in("bookshelf"), plain("bookshelf"))
    control = motions(world, seed)
    verdict = certify(world, control[None])
    samples = dense(control, STEP)
    if verdict.free:
        assert verdict.reason is Reason.FREE
        assert not any(judge.collides(q) for q in samples)
        assert not any(world.in_collision(q) for q in samples)
    if not any(world.in_collision(q) for q in samples):
        assert verdict.reason in (Reason.FREE, Reason.UNDECIDED) or world.in_collision(verdict.local_point)


@settings(max_examples=18)
@given(st.integers(0, 2), st.integers(0, 10**6))
def test_a_refusal_shows_where(place, seed):
    world, _ = strewn(place)
    verdict = certify(world, motions(world, seed)[None])
    if verdict.free:
        return
    contacts = {contact.pair for contact in contacts_at(world, verdict.local_point)}
    assert (verdict.reason is Reason.CONTACT) == (verdict.pair in contacts)
    control = motions(world, seed)
    at = dense(control, 1e-4)
    assert np.abs(at - verdict.local_point).max(axis=1).min() < 1e-3
    piece, until = verdict.free_until
    assert piece == 0
    assert 0.0 <= until <= verdict.parameter <= 1.0
    before = dense(_until(control, until), STEP)
    if until > 0:
        assert not any(world.in_collision(q) for q in before)


@settings(max_examples=12)
@given(st.integers(0, 2), st.integers(0, 10**6), st.integers(2, 40))
def test_a_refusal_of_many_short_pieces_certifies_what_is_before(place, seed, count):
    world, _ = strewn(place)
    whole = dense(motions(world, seed))
    points = whole[np.linspace(0, len(whole) - 1, count + 1).astype(int)]
    pieces = np.array([[a, b] for a, b in pairwise(points)])
    verdict = certify(world, pieces)
    if verdict.free:
        return
    piece, until = verdict.free_until
    assert (piece, until) <= (verdict.piece, verdict.parameter)
    last = pieces[piece, 0] + until * (pieces[piece, 1] - pieces[piece, 0])
    before = np.array([*points[: piece + 1], last])
    samples = np.concatenate([dense(np.array([a, b])) for a, b in pairwise(before)])[1:-1]
    if (piece, until) > (0, 0.0):
        assert not any(world.in_collision(world.group.from_local(z)) for z in samples)


def test_a_motion_that_touches_all_along_is_certified_nowhere():
    world = world_of(grouped(box_arm("y", 2)), [box("wall", (0.1, 0.1, 0.1), (0.0, 0.0, 0.5))])
    points = 1e-3 * np.arange(4)[:, None] * np.ones(world.group.nv)
    verdict = certify(world, np.array([[a, b] for a, b in pairwise(points)]))
    assert verdict.reason is Reason.CONTACT
    assert verdict.free_until == (verdict.piece, verdict.parameter) == (0, 0.0)


def _until(control: np.ndarray, t: float) -> np.ndarray:
    """Control points of a curve from 0 to t: the blossom with ever more arguments t."""
    rows, row = [control[0]], control
    while len(row) > 1:
        row = (1 - t) * row[:-1] + t * row[1:]
        rows.append(row[0])
    return np.array(rows)


@settings(max_examples=12)
@given(st.integers(0, 2), st.integers(0, 10**6))
def test_a_needle_in_the_way_is_refused(place, seed):
    world, _ = strewn(place)
    control = motions(world, seed)
    if not certify(world, control[None]).free:
        return
    rng = np.random.default_rng(seed)
    q = _until(control, rng.random())[-1]
    data = world.model.createData()
    pin.forwardKinematics(world.model, data, q)
    bodies = [shape for shape in world.group.geometry.geometryObjects if hasattr(shape.geometry, "points")]
    body = [shape for shape in bodies if shape.parentJoint > 0][
        rng.integers(sum(shape.parentJoint > 0 for shape in bodies))
    ]
    point = (data.oMi[body.parentJoint] * body.placement).act(
        np.array(body.geometry.points())[rng.integers(body.geometry.num_points)]
    )
    needle = box("needle", (1e-3, 1e-3, 0.05), point)
    pierced = world_of(world.group, [*world.scene.message.obstacles, needle])
    verdict = certify(pierced, control[None])
    assert not verdict.free
    assert verdict.pair[1] == "needle"


@pytest.mark.parametrize("seed", range(6))
def test_a_needle_through_a_mesh_is_refused_though_its_hull_is_asked_first(seed):
    arm, rng = group("ur5"), np.random.default_rng(seed)
    control = rest(arm) + np.cumsum(rng.normal(size=(3, arm.nv)) * 0.1, axis=0)
    world = world_of(arm, [box("far", (0.1, 0.1, 0.1), (3, 0, 0))])
    if not certify(world, control[None]).free:
        return
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, _until(control, rng.random())[-1])
    meshes = [shape for shape in arm.geometry.geometryObjects if hasattr(shape.geometry, "vertices")]
    meshes = [shape for shape in meshes if shape.parentJoint > 1]
    body = meshes[rng.integers(len(meshes))]
    vertices = np.array(body.geometry.vertices())
    point = (data.oMi[body.parentJoint] * body.placement).act(vertices[rng.integers(len(vertices))])
    verdict = certify(world_of(arm, [box("needle", (1e-3, 1e-3, 0.02), point)]), control[None])
    assert not verdict.free
    assert verdict.pair[1] == "needle"


@settings(max_examples=6)
@given(st.integers(0, 2), st.integers(0, 10**6), st.floats(0.3, 3.0))
def test_the_clearance_asked_for_is_kept(place, seed, share):
    world, _ = strewn(place)
    control = motions(world, seed)
    if not certify(world, control[None]).free:
        return
    samples = dense(control, 2e-3)
    least = min(clearance_at(world, q).obstacle_distance for q in samples)
    verdict = certify(world, control[None], min_clearance=share * least)
    if share > 1.0:
        assert not verdict.free
        assert verdict.reason in (Reason.TOO_CLOSE, Reason.UNDECIDED)
        assert clearance_at(world, verdict.local_point).obstacle_distance <= share * least + 2e-4
    # Between samples the clearance may be less by what two millirad move, and the certificate needs its resolution.
    elif (1.0 - share) * least > 4e-3:
        assert verdict.free


def test_the_clearance_is_about_obstacles_only():
    world = panda_in("bookshelf")
    q = rest(world.group)
    at = clearance_at(world, q)
    assert at.self_distance < 0.14
    folded = np.array([0, -0.785, 0, -2.9, 0, 1.571, 0.785])
    close = clearance_at(world, folded)
    asked = 0.5 * (close.self_distance + close.obstacle_distance)
    assert close.self_distance < asked < close.obstacle_distance
    assert motion_free(world, folded, folded + 1e-4, min_clearance=asked).free


def test_contact_within_a_motion_whose_ends_are_free_is_found():
    arm = group("panda")
    start, end = rest(arm), rest(arm)
    start[0], end[0] = -0.6, 0.6
    world = world_of(arm, [box("pole", (0.01, 0.01, 1.5), (0.3, 0, 0.75))])
    assert not world.in_collision(start)
    assert not world.in_collision(end)
    verdict = motion_free(world, start, end)
    assert verdict.reason is Reason.CONTACT
    assert verdict.pair[1] == "pole"
    assert 0.2 < verdict.parameter < 0.8
    assert verdict.evaluations < 100


def test_a_motion_that_is_none_is_judged_too():
    world = panda_in("bookshelf")
    q = rest(world.group)
    assert motion_free(world, q, q).free
    inside = world_of(world.group, [box("crate", (0.1, 0.1, 0.1), (0.307, 0, 0.55))])
    assert motion_free(inside, q, q).reason is Reason.CONTACT
    assert certify(world, np.empty((0, 4, 7))).free


def sliding_along(gap: float):
    """An arm that slides along a wall at a distance; the motion is free."""
    arm = grouped(box_arm("slide", 1))
    return world_of(arm, [box("wall", (1.0, 0.1, 3.0), (0, 0.02 + 0.05 + gap, 0))])


def test_what_passes_closer_than_the_stand_off_is_undecided():
    start, end = np.array([0.05]), np.array([0.12])
    for gap, reason in ((5e-7, Reason.CONTACT), (1.03e-6, Reason.UNDECIDED)):  # the one is contact to Coal
        verdict = motion_free(sliding_along(gap), start, end)
        assert verdict.reason is reason
        assert verdict.pair == ("l1", "wall")
    assert motion_free(sliding_along(2e-6), start, end).free


@pytest.mark.parametrize("pieces", [1, 3, 200])
@pytest.mark.parametrize("clearance", [0.0, 0.01])
def test_a_motion_that_goes_into_an_obstacle_is_in_contact_and_not_undecided(pieces, clearance):
    """Contact begins where a piece does, in the middle of one, and at places that halving doesn't meet."""
    arm, (vertices, triangles) = grouped(box_arm("slide", 1)), l_prism()
    far = clearance_at(world_of(arm, [box("wall", (1.0, 1.0, 0.2), (0, 0, 3.0))]), np.zeros(1)).obstacle_distance
    for gap in (0.25, 0.2, 0.2 + 1e-4 / 3, 0.1):
        bottom = 2.9 - far + gap
        for wall in (
            box("wall", (1.0, 1.0, 0.2), (0, 0, bottom + 0.1)),
            mesh_message(vertices + np.array([-0.5, -0.5, bottom]), triangles, "wall"),
        ):
            world = world_of(arm, [wall])
            way = np.linspace(-0.2, 0.4, pieces + 1)[:, None]
            verdict = certify(world, np.array([*pairwise(way)]), clearance)
            assert verdict.reason is Reason.CONTACT or (clearance and verdict.reason is Reason.TOO_CLOSE)
            piece, until = verdict.free_until
            assert 0.6 * (piece + until) / pieces - 0.2 <= gap - clearance <= verdict.local_point[0] + 1e-5


@pytest.mark.parametrize(
    "joints",
    ["slide y slide x", "y x mimic mimic", "continuous continuous y", "continuous x screw", "oblique oblique oblique"],
)
@pytest.mark.parametrize("seed", [0])
def test_other_joints_are_certified_as_soundly(joints, seed):
    rng = np.random.default_rng(seed)
    arm = grouped(box_arm(joints, 0))
    at_rest = arm.expand_from_local(np.full(arm.nv, 0.1))
    obstacles = [o for o in scattered(rng, 12, reach=1.2) if not world_of(arm, [o]).in_collision(at_rest)]
    world = world_of(arm, obstacles)
    outcomes = set()
    for _ in range(15):
        control = np.full(arm.nv, 0.1) + np.cumsum(rng.normal(size=(4, arm.nv)) * 0.25, axis=0)
        verdict = certify(world, control[None])
        outcomes.add(verdict.reason)
        if verdict.free:
            for z in dense(control, STEP):
                assert (pair_distances(world, arm.from_local(z)) > 0.0).all()
        elif verdict.reason is Reason.CONTACT:
            assert world.in_collision(arm.expand_from_local(verdict.local_point))
    assert outcomes & {Reason.FREE, Reason.CONTACT}


def test_a_whole_turn_of_a_continuous_joint_is_judged_as_a_turn():
    arm = grouped(box_arm("y continuous", 0))
    start, end = np.array([0.5, 0.0]), np.array([0.5, 2 * np.pi])
    assert arm.from_local(start) == pytest.approx(arm.from_local(end))
    turned = arm.expand_from_local(np.array([0.5, 2.0]))
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, turned)
    hit = data.oMi[2].act(np.array([0, 0, 0.25]))
    world = world_of(arm, [messages.Sphere(name="ball", radius=0.02, position=tuple(hit.tolist()))])
    assert not motion_free(world, start, end).free
    assert motion_free(world, start, start).free


def test_surfaces_are_kept_away_from():
    arm = group("panda")
    vertices, triangles = l_prism()
    shelf = mesh_message(0.1 * vertices, triangles, position=(0.45, 0.25, 0.4))
    wall = messages.Polygon(
        name="wall", vertices=[(0.6, -0.5, 0.2), (0.6, 0.5, 0.2), (0.6, 0.5, 0.9), (0.6, -0.5, 0.9)]
    )
    world = world_of(arm, [shelf, wall])
    rng = np.random.default_rng(0)
    outcomes = []
    for _ in range(20):
        control = rest(arm) + np.cumsum(rng.normal(size=(4, 7)) * 0.2, axis=0)
        verdict = certify(world, control[None])
        outcomes.append(verdict.reason)
        if verdict.free:
            assert not any(world.in_collision(q) for q in dense(control, STEP))
    assert {Reason.FREE, Reason.CONTACT} <= set(outcomes)


def test_questions_before_do_not_change_an_answer():
    world, _ = strewn(0)
    first = [certify(world, motions(world, seed)[None]) for seed in range(12)]
    again = [certify(world, motions(world, seed)[None]) for seed in reversed(range(12))][::-1]
    for a, b in zip(first, again, strict=True):
        for fact in ("reason", "piece", "parameter", "free_until", "pair", "evaluations"):
            assert getattr(a, fact) == getattr(b, fact)


def test_a_judgement_that_is_stopped_certifies_what_comes_before(monkeypatch):
    monkeypatch.setattr(search, "SEGMENTS_AT_ONCE", 5)
    arm = group("panda")
    world = world_of(arm, [box("pole", (0.01, 0.01, 1.5), (0.292, 0, 0.75))])
    points = np.tile(rest(arm), (201, 1))
    points[:, 0] = np.linspace(-1.2, -0.4, 201)
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    whole = certify(world, pieces)
    assert whole.free
    for rounds in range(2):
        left = iter([None] * rounds)
        verdict = certify(world, pieces, deadline=Deadline(is_cancelled=lambda left=left: bool(next(left, "enough"))))
        assert verdict.reason is Reason.STOPPED
        assert not verdict.free
        assert verdict.evaluations < whole.evaluations
        assert (verdict.piece > 0) == (rounds > 0)
        assert certify(world, pieces[: verdict.piece]).free


def test_a_refusal_that_coal_does_not_confirm_is_no_answer(monkeypatch):
    arm = group("panda")
    start, end = rest(arm), rest(arm)
    start[0], end[0] = -0.6, 0.6
    world = world_of(arm, [box("pole", (0.01, 0.01, 1.5), (0.3, 0, 0.75))])
    monkeypatch.setattr(World, "penetration_of", lambda *_, **__: None)
    with pytest.raises(search.ContradictionError, match="Coal hasn't"):
        motion_free(world, start, end)


def test_a_deadline_that_passes_among_the_smallest_distances_leaves_the_verdict(monkeypatch):
    """Time is up after a few segments of a pass that asks for both: what the certificate lacks is done."""

    class Late:
        """A deadline that passes once the search has begun."""

        asked = 0

        def expired(self) -> bool:
            self.asked += 1
            return self.asked > 1

    world = panda_in("bookshelf")
    z = world.group.to_local(world.group.part_of(world.group.robot.rest))
    curve = Curve(np.array([[z, z + np.linspace(0.3, -0.2, len(z))]]), np.array([0.0, 1.0]))
    goal = SearchQuery(0.0, spans=[(0.0, 1.0)], samples=np.linspace(0.0, 1.0, 9))
    whole = search.search(world, curve, goal)
    monkeypatch.setattr(search, "SEGMENTS_AT_ONCE", 3)
    cut = search.search(world, curve, goal, Late())
    assert whole.verdict.free
    assert cut.verdict.free
    assert 0.0 < cut.obstacle[0].bound <= whole.obstacle[0].bound
    late = Late()
    late.asked = 1
    assert search.search(world, curve, goal, late).verdict.reason is Reason.STOPPED
    monkeypatch.setattr(search, "LAST_SEGMENTS", 3)
    assert search.search(world, curve, goal, Late()).verdict.reason is Reason.STOPPED


UPRIGHT, LYING = np.eye(3), pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0)

sizes = st.floats(-2.0, 0.0).map(lambda exponent: 10.0**exponent)
apart = st.floats(-4.0, 1.3).map(lambda exponent: 10.0**exponent)
share = st.floats(-0.4, 0.4)


@given(apart, sizes, sizes, st.floats(0.1, 10.0), st.floats(0.1, 10.0), share, share, st.integers(0, 2**32 - 1))
def test_coal_is_as_exact_as_the_margins_allow(distance, one, other, long, tall, along, up, seed):
    # An upright cylinder touches the plane x = 0 from below, a lying one the plane x = distance from above; the lines
    # in which they touch cross, so they are that distance apart.
    first = pin.SE3(UPRIGHT, np.array([-one, 0.0, along * long]))
    second = pin.SE3(LYING, np.array([distance + other, up * tall, 0.0]))
    pose = np.random.default_rng(seed).normal(size=7)
    turned = pin.SE3(pin.Quaternion(pose[3:] / np.linalg.norm(pose[3:])), pose[:3])
    places = [coal.Transform3s(at.rotation, at.translation) for at in (turned * first, turned * second)]
    shapes = coal.Cylinder(one, long), coal.Cylinder(other, tall)
    told = coal.distance(shapes[0], places[0], shapes[1], places[1], coal.DistanceRequest(), coal.DistanceResult())
    assert distance <= with_coal_error(told)
    assert told <= with_coal_error(distance)


@pytest.mark.parametrize("distance", [-2.0, -1e-3, 0.0, 1e-6, 0.3, 20.0])
def test_more_is_asked_for_than_has_to_be_kept(distance):
    error = COAL_ACCURACY + COAL_RELATIVE * abs(distance)
    assert with_coal_error(distance) == pytest.approx(distance + error, rel=0.0, abs=1e-15)
    assert with_coal_error(np.array([distance]))[0] == with_coal_error(distance)


PANDA = group("panda")
START = PANDA.to_local(rest(PANDA))
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
        q = PANDA.from_local(START + share * (END - START))
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
        assert verdict.local_point is not None


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
                assert not any(now.in_collision(world.group.expand_from_local(z)) for z in inside)
    else:
        assert verdict.free_until is not None
