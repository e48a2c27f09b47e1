"""The referee's verdicts: against dense samples, against the certificate, and on cases made to be refused."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from guidefield import case_file
from guidefield.collision.clearance import find_enclosed_pair
from guidefield.collision.world import World
from guidefield.handlers.attached import HeldShape, add_held_links
from guidefield.messages import scene as messages
from guidefield.messages.conditions import AttachedObject, LineConstraint, OrientationCone, PlaneConstraint
from guidefield.messages.values import Placement
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.certificate import certify
from guidefield.referee.case import Answer
from guidefield.referee.judge import Along, judge
from guidefield.referee.loading import case_of
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import build
from tests.collision.scenery import box, panda_in, world_of
from tests.referee.cases import read, straight
from tests.referee.drawn import Drawn, draw
from tests.robots import box_arm, group, grouped, rest
from tests.scene.solids import box_mesh, l_prism, room

SAMPLES = 60


def obstacle_mesh(name: str, shape: tuple[np.ndarray, np.ndarray], scale: float, position: Any) -> messages.Mesh:
    vertices, triangles = shape
    return messages.Mesh(
        name=name,
        vertices=[tuple(v) for v in (scale * vertices).tolist()],
        triangles=[tuple(t) for t in triangles.tolist()],
        position=tuple(map(float, position)),
    )


def touched(drawn: Drawn) -> float | None:
    """When a dense sample touches, or a body is wholly inside another's closed mesh."""
    world, motion = drawn.motion.world, drawn.motion
    trajectory = Trajectory(motion.times, motion.positions, motion.velocities)
    for now in np.linspace(0.0, motion.times[-1], SAMPLES):
        here = World.build(world.group, world.scene.at(now)) if world.scene.moves else world
        q = world.group.expand_from_local(trajectory.evaluate(np.array([now]))[0][0])
        if here.in_collision(q) or find_enclosed_pair(here, q):
            return float(now)
    return None


def certified(drawn: Drawn) -> bool:
    world, motion = drawn.motion.world, drawn.motion
    trajectory = Trajectory(motion.times, motion.positions, motion.velocities)
    begin = World.build(world.group, world.scene.at(0.0))
    if find_enclosed_pair(begin, world.group.expand_from_local(motion.positions[0])):
        return False
    if world.scene.moves:
        timed = world
        return certify(timed, trajectory.bezier(), motion.min_clearance, times=trajectory.piece_times()).free
    return certify(world, trajectory.bezier(), motion.min_clearance).free


@pytest.mark.parametrize(("moving", "count"), [(False, 20), (True, 10)], ids=["at rest", "moving"])
def test_it_agrees_with_the_certificate_and_with_dense_samples(moving, count):
    answers = []
    for seed in range(count):
        drawn = draw(np.random.default_rng([seed, moving]), moving)
        finding = judge(read(drawn.motion, limits=False)).finding
        answers.append(finding.answer)
        when = touched(drawn)
        assert (when is None) or finding.answer is not Answer.FREE, (seed, when)
        assert certified(drawn) == (finding.answer is Answer.FREE), (seed, finding)
        if finding.answer is Answer.CONTACT:
            moment = min(finding.time, drawn.motion.times[-1])
            world = World.build(drawn.motion.world.group, drawn.motion.world.scene.at(moment))
            trajectory = Trajectory(drawn.motion.times, drawn.motion.positions, drawn.motion.velocities)
            q = world.group.expand_from_local(trajectory.evaluate(np.array([moment]))[0][0])
            assert world.in_collision(q), (seed, finding)
    assert {Answer.FREE, Answer.CONTACT} <= set(answers)


def arm() -> PlanningGroup:
    return grouped(box_arm("y y", 2), "l2")


def test_a_motion_one_millimetre_into_a_box_is_refused_with_the_pair():
    """The arm's links are 4 cm wide and stand upright: turned by a quarter the last one ends 0.885 m from the base."""
    planned = grouped(box_arm("slide", 1), "l1")
    for depth, answer in ((1e-3, Answer.CONTACT), (-1e-3, Answer.FREE)):
        block = box("block", (0.2, 0.2, 0.2), (0.0, 0.0, 0.885 + 0.1 - depth))
        motion = straight(world_of(planned, [block]), [[0.0], [0.3]])
        finding = judge(read(motion)).finding
        assert finding.answer is answer
        assert finding.about == (("l1", "block") if depth > 0.0 else ())


def test_clearance_is_kept_to_the_micrometre_and_extra_is_asked_for_on_top():
    planned = grouped(box_arm("slide", 1), "l1")
    world = world_of(planned, [box("block", (0.2, 0.2, 0.2), (0.0, 0.0, 0.885 + 0.1 + 0.01))])
    ends = [[0.0], [0.3]]
    assert judge(read(straight(world, ends, 0.01 - 1e-5))).answer is Answer.FREE
    refused = judge(read(straight(world, ends, 0.01 + 1e-5))).finding
    assert refused.answer is Answer.TOO_CLOSE
    assert refused.distance == pytest.approx(0.01, abs=1e-4)
    near = read(straight(world, ends, 0.01 - 2e-4))
    assert 0.0 <= judge(near).kept <= 2e-4
    assert judge(near, extra=1e-4).answer is Answer.FREE
    assert judge(near, extra=3e-4).answer is Answer.TOO_CLOSE


def test_what_the_robot_keeps_from_itself_may_be_asked_for():
    """Folded, the third link comes back towards the first."""
    planned = grouped(box_arm("y y y", 3), "l3")
    world = world_of(planned, [])
    case = read(straight(world, [[0.0, 0.0, 0.0], [0.0, 1.2, 1.2]]))
    free = judge(case)
    assert free.answer is Answer.FREE
    assert free.pairs > 0
    assert judge(case, own_extra=1.0).answer is Answer.TOO_CLOSE


def test_time_is_limited():
    case = read(straight(world_of(arm(), [box("b", (0.1, 0.1, 0.1), (0.5, 0.0, 1.5))]), [[0.0, 0.0], [1.0, 1.0]]))
    finding = judge(case, seconds=0.0).finding
    assert (finding.answer, finding.about) == (Answer.UNDECIDED, ("time was up",))


def test_a_pair_too_near_to_be_told_apart_is_undecided():
    planned = grouped(box_arm("slide", 1), "l1")
    wall = box("wall", (0.1, 0.1, 2.0), (0.07 + 1.5e-6, 0.0, 1.0))
    finding = judge(read(straight(world_of(planned, [wall]), [[0.0], [1e-4]]))).finding
    assert (finding.answer, finding.about) == (Answer.UNDECIDED, ("l1", "wall"))


@pytest.mark.parametrize("mimic", ["gear", "half-gear", "mimic", "screw"])
def test_mimic_joints_follow_the_unwrapped_value_beyond_half_a_turn(mimic):
    """A ball is within the last link where that is once the source joint has turned by 4 rad; or beside it."""
    planned = grouped(box_arm(f"continuous {mimic}", 2), "l2")
    world = world_of(planned, [])
    world.place(planned.expand_from_local(np.array([4.0])))
    there = world.placement(2)
    for beside, answer in ((0.0, Answer.CONTACT), (0.1, Answer.FREE)):
        place = tuple(there.act(np.array([0.0, beside, 0.0])).tolist())
        among = world_of(planned, [messages.Sphere(name="ball", radius=0.005, position=place)], [("l0", "l2")])
        finding = judge(read(straight(among, [[3.99], [4.0]]), limits=False)).finding
        assert finding.answer is answer
        assert finding.about == ((), ("l2", "ball"))[answer is Answer.CONTACT]


def hermite(positions: Any, velocities: Any, times: Any) -> Trajectory:
    return Trajectory(np.array(times, float), np.array(positions, float), np.array(velocities, float))


def of_trajectory(world: World, trajectory: Trajectory, **more: Any) -> case_file.Motion:
    return case_file.Motion(
        world, Placement(), (), trajectory.times, trajectory.positions, trajectory.velocities, **more
    )


def test_an_overshoot_between_knots_is_beyond_the_limit():
    """Both knots are at 1.99 rad, the limit is 2; at 0.2 rad/s up and down it rises by 0.2 / 4 in between."""
    planned = grouped(box_arm("y", 1), "l1")
    limited = planned.with_limits({"j1": 10.0}, {"j1": 100.0}, 1.0, 1.0)
    world = world_of(limited, [])
    found = judge(read(of_trajectory(world, hermite([[1.99], [1.99]], [[0.2], [-0.2]], [0, 1])))).finding
    assert (found.answer, found.about) == (Answer.BEYOND_LIMIT, ("j1", "position"))
    assert found.time == pytest.approx(0.5)
    assert found.distance == pytest.approx(1.99 + 0.05 - 2.0)
    assert judge(read(of_trajectory(world, hermite([[1.99], [1.99]], [[0.03], [-0.03]], [0, 1])))).answer is Answer.FREE


@pytest.mark.parametrize(("kind", "limits"), [("velocity", 1.49), ("acceleration", 5.9), ("jerk", 11.9)])
def test_rates_are_judged_at_their_extrema(kind, limits):
    """From rest to rest by 1 rad in 1 s: at most 1.5 rad/s, 6 rad/s^2 and 12 rad/s^3."""
    planned, swing = grouped(box_arm("y", 1), "l1"), hermite([[0.0], [1.0]], [[0.0], [0.0]], [0, 1])
    enough = {"velocity": 1.5, "acceleration": 6.0, "jerk": 12.0}
    for asked, answer in ((enough, Answer.FREE), (enough | {kind: limits}, Answer.BEYOND_LIMIT)):
        limited = planned.with_limits({"j1": asked["velocity"]}, {"j1": asked["acceleration"]}, 1.0, 1.0)
        motion = of_trajectory(world_of(limited, []), swing, jerk_limits=np.array([asked["jerk"]]))
        finding = judge(read(motion)).finding
        assert finding.answer is answer
        assert finding.about == ((), ("j1", kind))[answer is Answer.BEYOND_LIMIT]


def test_a_mimic_joint_has_limits_of_its_own():
    """At 6 rad the mimic joint is at 0.2 * 6 - 0.1 = 1.1 m."""
    planned = grouped(box_arm("wide screw", 2), "l2")
    (told,) = case_file.make_cases(straight(world_of(planned, []), [[0.0], [6.0]]))
    for upper, answer in ((1.11, Answer.FREE), (1.09, Answer.BEYOND_LIMIT)):
        narrow = told["robot"] | {"urdf": told["robot"]["urdf"].replace('upper="2"', f'upper="{upper}"')}
        finding = judge(case_of(told | {"robot": narrow})).finding
        assert finding.answer is answer
        assert finding.about == ((), ("j2", "position"))[answer is Answer.BEYOND_LIMIT]


def test_a_start_wholly_inside_a_closed_mesh_is_refused_and_a_room_is_free():
    planned = arm()
    ends = [[0.0, 0.0], [0.3, 0.3]]
    block = obstacle_mesh("block", box_mesh(), 5.0, (0, 0, 0))
    solid_l = obstacle_mesh("l", l_prism(), 4.0, (-1.5, -1.5, -1.5))
    hall = obstacle_mesh("hall", room(6.0, 5.0), 1.0, (0, 0, 0))
    for obstacle, answer in ((block, Answer.INSIDE), (solid_l, Answer.INSIDE), (hall, Answer.FREE)):
        finding = judge(read(straight(world_of(planned, [obstacle]), ends))).finding
        assert finding.answer is answer
        assert (finding.about[:1] == (obstacle.name,)) == (answer is Answer.INSIDE)
    vertices, triangles = box_mesh()
    inside_out = obstacle_mesh(
        "block", (vertices, np.where(np.arange(12)[:, None] % 2, triangles, triangles[:, ::-1])), 5, (0, 0, 0)
    )
    assert judge(read(straight(world_of(planned, [inside_out]), ends))).answer is Answer.INSIDE
    loose = obstacle_mesh("block", (vertices[triangles].reshape(-1, 3), np.arange(36).reshape(-1, 3)), 5.0, (0, 0, 0))
    assert judge(read(straight(world_of(planned, [loose]), ends))).answer is Answer.INSIDE
    opened = obstacle_mesh("block", (vertices, triangles[1:]), 5.0, (0, 0, 0))
    assert judge(read(straight(world_of(planned, [opened]), ends))).answer is Answer.FREE


def test_a_part_that_does_not_contain_its_mesh_is_refused():
    """The file says that the hull of an L is smaller than it is; or that its closed surface lacks a triangle."""
    solid = obstacle_mesh("l", l_prism(), 0.1, (0.4, 0.0, 0.2))
    (told,) = case_file.make_cases(straight(world_of(arm(), [solid]), [[-0.5, 0.0], [-0.8, 0.0]]))
    assert judge(case_of(told)).answer is Answer.FREE
    smaller = json.loads(json.dumps(told))
    corners = smaller["parts"]["objects"]["l"]["hulls"][0]
    smaller["parts"]["objects"]["l"]["hulls"] = [(0.999 * np.array(corners)).tolist()]
    finding = judge(case_of(smaller)).finding
    assert (finding.answer, finding.about) == (Answer.FALSE_PART, ("l",))
    torn = json.loads(json.dumps(told))
    torn["parts"]["objects"]["l"]["shell"]["triangles"].pop()
    assert judge(case_of(torn)).answer is Answer.FALSE_PART
    without = json.loads(json.dumps(told))
    without["parts"]["objects"] = {}
    assert judge(case_of(without)).answer is Answer.FREE


def test_parts_contain_a_mesh_together():
    """Two boxes are an L; one of them isn't."""
    solid = obstacle_mesh("l", l_prism(), 0.1, (0.4, 0.0, 0.2))
    (told,) = case_file.make_cases(straight(world_of(arm(), [solid]), [[-0.5, 0.0], [-0.8, 0.0]]))
    corners = np.indices((2, 2, 2)).reshape(3, 8).T
    boxes = [(corners * size).tolist() for size in ([0.1, 0.2, 0.1], [0.2, 0.1, 0.1])]
    for hulls, answer in ((boxes, Answer.FREE), (boxes[:1], Answer.FALSE_PART)):
        told["parts"]["objects"]["l"]["hulls"] = hulls
        assert judge(case_of(told)).answer is answer


def holding_a_book(below: float) -> Any:
    """A Panda with a book of 10 cm, the edge of a shelf so far below the book's middle; the book, and where it is."""
    panda = group("panda")
    book = AttachedObject(
        obstacle=messages.Box(name="book", size=(0.1, 0.1, 0.1)),
        link="panda_hand",
        placement=Placement(position=(0.0, 0.0, 0.1)),
        touch_links=["panda_leftfinger", "panda_rightfinger"],
    )
    shape = build(messages.Scene(name="s", obstacles=[book.obstacle])).obstacles[0].shape
    placed = panda.robot.model.frames[0].placement.Identity()
    placed.translation = np.array([0.0, 0.0, 0.1])
    robot = add_held_links(panda.robot, [HeldShape("book", shape, placed, "panda_hand", tuple(book.touch_links))])
    holding = select(robot, None, None, robot.rest, placed.Identity())
    bare = world_of(holding, [])
    bare.place(holding.expand(rest(holding)))
    x, y, z = bare.placement(bare.pairs.links - 1).translation.tolist()
    return (
        world_of(holding, [box("shelf", (0.1, 0.1, 0.02), (x, y, z - below - 0.01))]),
        book,
        holding.to_local(rest(holding)),
    )


def test_a_held_object_is_a_body_of_the_robot():
    for below, answer in ((0.1, Answer.FREE), (0.045, Answer.CONTACT)):
        world, book, z = holding_a_book(below)
        motion = dataclasses.replace(straight(world, [z, z + 1e-3]), held=[book])
        finding = judge(read(motion)).finding
        assert finding.answer is answer
        assert finding.about == ((), ("book", "shelf"))[answer is Answer.CONTACT]


@pytest.mark.parametrize(
    ("constraint", "kept"),
    [
        (OrientationCone(frame="l2", axis=(0, 0, 1), target_axis=(0, 0, 1), half_angle=0.601), True),
        (OrientationCone(frame="l2", axis=(0, 0, 1), target_axis=(0, 0, 1), half_angle=0.599), False),
        (PlaneConstraint(frame="l2", point=(0, 0, 0), normal=(0, 3, 0), tolerance=1e-3), True),
        (PlaneConstraint(frame="l2", point=(0, 0, 0.6), normal=(0, 0, 1), tolerance=0.014), True),
        (PlaneConstraint(frame="l2", point=(0, 0, 0.6), normal=(0, 0, 1), tolerance=0.013), False),
        (LineConstraint(frame="l2", point=(0, 0, 0.6), direction=(1, 0, 0), tolerance=0.014), True),
        (LineConstraint(frame="l2", point=(0, 0, 0.6), direction=(1, 0, 0), tolerance=0.013), False),
    ],
)
def test_path_constraints_hold_between_samples(constraint, kept):
    """The second joint stands 0.3 m above the first: turned by 0.3 rad it sinks by 0.3 (1 - cos 0.3) = 13.4 mm."""
    motion = straight(world_of(arm(), []), [[-0.3, -0.3], [0.3, 0.3]])
    finding = judge(read(dataclasses.replace(motion, path_constraints=[constraint]))).finding
    assert finding.answer is (Answer.FREE if kept else Answer.CONSTRAINT_BROKEN)


@pytest.mark.parametrize("seed", range(12))
def test_no_sample_breaks_a_constraint_by_more_than_may_be_lost(seed: int) -> None:
    """In boxes about a place, of a Panda's tip: first and second order bound what counts of its motion."""
    rng, planned = np.random.default_rng(seed), group("panda")
    z = planned.to_local(rest(planned)) + rng.normal(size=planned.nv) * 0.3
    tip, there = "panda_hand", tuple(rng.normal(size=3).tolist())
    constraints = [
        OrientationCone(frame=tip, axis=there, target_axis=(0, 0, 1), half_angle=0.5),
        PlaneConstraint(frame=tip, point=there, normal=there, tolerance=0.1),
        LineConstraint(frame=tip, point=there, direction=(there[1], -there[0], 0.3), tolerance=0.1),
    ]
    motion = straight(world_of(planned, []), [z, z])
    along = Along(read(dataclasses.replace(motion, path_constraints=constraints)), 0.0, 0.0, np.inf)
    half = 10.0 ** rng.uniform(-4.0, -1.0) * rng.uniform(0.0, 1.0, planned.nv)
    along._stand(z, 0.0)
    numbers = range(len(along.pairs), len(along.names))
    lost = np.array([along._loss(k, *along._reach(half), half) for k in numbers])
    before = np.array([along._constraint(k)[2] for k in range(len(constraints))])
    most = np.full(len(constraints), -np.inf)
    for _ in range(300):
        along._stand(z + half * rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)], planned.nv), 0.0)
        most = np.maximum(most, [along._constraint(k)[2] for k in range(len(constraints))] - before)
    assert (most <= lost + 1e-9).all(), (most, lost)
    assert (most >= 0.1 * lost).any()


def test_pairs_that_are_left_out_are_told_and_the_rest_is_judged():
    planned, block = arm(), box("block", (0.2, 0.2, 0.2), (0.0, 0.0, 0.8))
    world = world_of(planned, [block], [("l2", "block")])
    verdict = judge(read(straight(world, [[0.0, 0.0], [0.1, 0.1]])))
    assert ("l2", "block", "the request allows it") in verdict.left_out
    assert ("l0", "block", "the link never moves") in verdict.left_out
    assert verdict.pairs == 1 + sum(1 for pair in world.pairs.own)


def test_a_contact_that_is_left_is_a_case_of_its_own():
    planned, block = arm(), box("block", (0.2, 0.2, 0.2), (0.119, 0.0, 0.8))
    world, touching = world_of(planned, [block]), [("l2", "block")]
    rest = straight(world, [[-0.3, 0.0], [-0.6, 0.0], [-0.7, 0.0]])
    out = straight(world_of(planned, [block], touching), [[0.0, 0.0], [-0.3, 0.0]])
    assert judge(read(straight(world, [[0.0, 0.0], [-0.3, 0.0]]))).finding.answer is Answer.CONTACT
    cases = [*map(case_of, case_file.make_cases(dataclasses.replace(out, touching=touching), rest))]
    verdicts = [judge(case) for case in cases]
    assert [verdict.answer for verdict in verdicts] == [Answer.FREE, Answer.FREE]
    assert ("l2", "block", "they touch at the start, and part") in verdicts[0].left_out
    assert not any("block" in pair and "l2" in pair for pair in verdicts[1].left_out)


def test_a_panda_among_ten_obstacles_keeps_what_it_is_said_to():
    world = panda_in("bookshelf")
    z = world.group.to_local(rest(world.group))
    case = read(straight(world, [z, z + 0.1]))
    assert judge(case).answer is Answer.FREE
    assert certify(world, np.array([[z, z + 0.1]])).free
