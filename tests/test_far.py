"""Far from the origin: a robot in a cell in the coordinates of a map is answered as at home."""

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield import (
    Box,
    CertifyRequest,
    Clearance,
    InverseKinematics,
    JointsGoal,
    Mesh,
    PlanRequest,
    PoseGoal,
    Scene,
    Sphere,
    Stream,
    answer,
    messages,
)
from guidefield.engine import Engine
from guidefield.geometry import surfaces
from guidefield.messages.conditions import TargetPose
from guidefield.messages.requests import GivenTrajectory, LineConstraint, PlanStep
from guidefield.messages.scene import HalfSpace, ObstacleTrajectory, PointCloud, Polygon
from guidefield.messages.streams import Observation, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import Float32Array, Placement
from guidefield.recorder.chunks import read_chunks
from guidefield.recorder.stored import read_recording
from guidefield.referee.case import Answer
from guidefield.referee.replay import replay_file
from guidefield.rendering import Renderings
from guidefield.scene import anchor
from guidefield.stores.recordings import Recordings

PLACES = ((1000.0, 0.0, 0.0), (60_000.3, 80_000.7, 1.0), (500_000.123, 4_000_000.456, 210.4))
Vector = tuple[float, float, float]


def there(place: Vector, x: float, y: float, z: float) -> Vector:
    return place[0] + x, place[1] + y, place[2] + z


def cell(place: Vector, *, moving: bool = False) -> Scene:
    """Obstacles of all kinds about a robot; a mesh and a moving cloud whose own points are those of the world."""

    def points(some: Any) -> list[Vector]:
        return [there(place, *one) for one in np.asarray(some).tolist()]

    block = surfaces.box((0.1, 0.2, 0.3))
    corners = points(block.vertices + np.array([0.4, -0.5, 0.5]))
    obstacles: list[Any] = [
        Box(name="post", size=(0.1, 0.1, 0.8), position=there(place, 0.5, 0.3, 0.4)),
        Sphere(name="ball", radius=0.1, position=there(place, -0.5, 0.4, 0.6)),
        Mesh(name="block", vertices=corners, triangles=block.triangles.tolist()),
        Polygon(name="sheet", vertices=points([[-0.6, -0.6, 0.9], [-0.2, -0.6, 0.9], [-0.2, -0.4, 0.9]])),
        HalfSpace(name="floor", normal=(0.0, 0.0, 2.0), offset=2.0 * (place[2] - 0.1)),
        PointCloud(name="scan", points=points([[-0.4, -0.5, 0.3], [-0.45, -0.5, 0.4]]), radius=0.03),
    ]
    if moving:
        still = (0.0, 0.0, 0.0, 1.0)
        ways = [Placement(position, still) for position in ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
        cloud = points([[-0.7, 0.0, 0.2], [-0.7, 0.1, 0.2]])
        way = ObstacleTrajectory([0.0, 2.0], ways)
        obstacles.append(PointCloud(name="flock", points=cloud, radius=0.05, trajectory=way))
        ways = [Placement(there(place, 0.9, y, 0.5), still) for y in (-1.0, 1.0)]
        cart = ObstacleTrajectory([0.0, 3.0], ways)
        obstacles.append(Box(name="cart", size=(0.2, 0.2, 0.2), trajectory=cart))
    return Scene("cell", obstacles=obstacles)


GOAL = {"shoulder_pan_joint": 1.0, "elbow_joint": 1.2}


def plan(place: Vector, **more: Any) -> PlanRequest:
    moving = more.pop("moving", False)
    asked = {"goal": JointsGoal(GOAL), "guide_planes": [], "optimization_iterations": 20, **more}
    standing = Placement(position=place)
    return PlanRequest("ur5", cell(place, moving=moving), robot_placement=standing, **asked)


def same(near: Any, far: Any, within: float) -> None:
    assert near.status.name == far.status.name == "SUCCESS"
    assert far.trajectory.times[-1] == pytest.approx(near.trajectory.times[-1], rel=within)
    assert far.clearance.minimum == pytest.approx(near.clearance.minimum, abs=within)


@pytest.mark.parametrize("place", PLACES, ids=("1 km", "100 km", "4,000 km"))
def test_a_plan_far_away_is_that_at_home(place: Vector) -> None:
    same(answer(plan((0.0, 0.0, 0.0))), answer(plan(place)), 1e-5)


def test_poses_and_constraints_are_those_of_the_world() -> None:
    def asked(place: Vector) -> PlanRequest:
        turned = (0.5, 0.5, -0.5, 0.5)
        line = LineConstraint("tool0", there(place, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2.0)
        goal = PoseGoal(there(place, 0.3, 0.5, 0.5), turned, orientation_tolerance=(None, None, None))
        return plan(place, goal=goal, path_constraints=[line])

    same(answer(asked((0.0, 0.0, 0.0))), answer(asked(PLACES[-1])), 1e-4)


def test_a_certificate_clearances_and_poses_far_away() -> None:
    near = answer(plan((0.0, 0.0, 0.0)))
    rows, smallest = near.trajectory.positions, []
    for place in ((0.0, 0.0, 0.0), PLACES[-1]):
        judged = answer(
            CertifyRequest(
                "ur5",
                cell(place),
                path=rows,
                position_names=near.position_names,
                robot_placement=Placement(position=place),
            )
        )
        assert judged.status.name == "SUCCESS"
        smallest.append(judged.clearance.minimum)
    assert smallest[1] == pytest.approx(smallest[0], abs=1e-7)
    asked = [
        Clearance("ur5", cell(place), [GOAL], robot_placement=Placement(position=place), packed=packed)
        for place in ((0.0, 0.0, 0.0), PLACES[-1])
        for packed in (False, True)
    ]
    at_home, packed_home, away, packed_away = map(answer, asked)
    assert away.minimum == pytest.approx(at_home.minimum, abs=1e-8)
    off = np.array(away.witness_points) - np.array(at_home.witness_points)
    assert off == pytest.approx(np.broadcast_to(PLACES[-1], off.shape), abs=1e-8)
    points = [np.frombuffer(one.packed.witness_points.float64) for one in (packed_home, packed_away)]
    assert points[1] - points[0] == pytest.approx(np.tile(PLACES[-1], 2), abs=1e-8)
    pose = TargetPose(there(PLACES[-1], 0.3, 0.5, 0.5), (0.5, 0.5, -0.5, 0.5))
    found = answer(
        InverseKinematics(
            "ur5", [pose], robot_placement=Placement(position=PLACES[-1]), scene=cell(PLACES[-1]), collision_free=True
        )
    )
    assert found.configurations[0]


@pytest.mark.parametrize("deferred", [False, True])
def test_a_recording_and_a_proof_speak_of_the_world(tmp_path: Path, deferred: bool) -> None:
    steps = [PlanStep(JointsGoal(GOAL)), PlanStep(JointsGoal({}))] if deferred else []
    goal = None if deferred else JointsGoal(GOAL)
    request = plan(PLACES[-1], recording="summary", steps=steps, goal=goal)
    file, proof = tmp_path / "run.rrd", tmp_path / "run.npz"
    reply = Engine().answer(request, record_to=file, proof_to=proof, deferred=deferred)
    Renderings().render(Recordings(tmp_path), "run", whole=True)
    assert reply.status.name == "SUCCESS"
    assert reply.proof is not None, reply.warnings
    chunks = {chunk.entity_path: chunk.to_record_batch() for chunk in read_chunks(file)}
    assert "/" not in chunks, "a transform of all would have the view look at the world's origin"
    (drawn_from,) = chunks["/__properties/plan"].column("drawn_from").to_pylist()
    assert drawn_from == [round(x) for x in PLACES[-1]]
    kept = read_recording(file)
    assert msgspec.json.encode(msgspec.structs.replace(kept.request, proof=False)) == msgspec.json.encode(request)
    assert kept.reply.trajectory == reply.trajectory
    assert {one.answer for one in replay_file(proof)} == {Answer.FREE}
    told = msgspec.json.decode(np.load(proof)["cases"].tobytes())[0]
    assert told["robot"]["placement"]["position"] == list(PLACES[-1])
    assert told["obstacles"][0] == msgspec.json.decode(msgspec.json.encode(request.scene.obstacles[0]))


def driven(start: Vector, place: Vector = (0.0, 0.0, 0.0)) -> PlanRequest:
    """A base drives straight on between two walls."""
    x, y, angle = start
    walls = [
        Box(name=str(side), size=(0.1, 2.0, 1.0), position=there(place, x + 1.5, y + side, 0.0)) for side in (1.6, -1.6)
    ]
    return PlanRequest(
        "chain_planar_3x260_r25",
        Scene("gate", obstacles=walls),
        JointsGoal({"root_joint": [x + 3.0, y, angle]}),
        start={"root_joint": [x, y, angle]},
        robot_placement=Placement(position=place),
        guide_planes=[],
    )


def test_a_base_kilometres_away_drives_as_at_home() -> None:
    near = answer(driven((0.0, 0.0, 0.0)))
    for place, start in (((0.0, 0.0, 0.0), (5000.0, -3000.0, 0.0)), ((1e6, 2e6, 0.0), (400_000.5, 4e5, 0.0))):
        far = answer(driven(start, place))
        same(near, far, 1e-4)
        columns = [far.position_names.index(f"root_joint.{axis}") for axis in "xy"]
        rows = [[row[k] for k in columns] for row in (far.trajectory.positions[0], far.trajectory.positions[-1])]
        assert rows == [[start[0], start[1]], [start[0] + 3.0, start[1]]]


@pytest.mark.parametrize("named", [True, False])
def test_a_drive_kilometres_away_is_judged_as_at_home(named: bool) -> None:
    smallest = []
    for start in ((0.0, 0.0, 0.0), (400_000.5, 4e6, 0.0)):
        asked = driven(start)
        planned = answer(asked)
        motion = planned.trajectory
        names = planned.position_names if named else None
        given = GivenTrajectory(motion.positions, motion.times, motion.velocities)
        judged = answer(CertifyRequest(asked.robot, asked.scene, trajectory=given, position_names=names))
        assert judged.status.name == "SUCCESS"
        smallest.append(judged.clearance.minimum)
        into = [[start[0], start[1] - 1.6, 0.0, *planned.path[0][3:]], [start[0] + 3.0, *planned.path[-1][1:]]]
        into[1][1] = into[0][1]  # into the wall on the right
        refused = answer(CertifyRequest(asked.robot, asked.scene, path=into, position_names=names))
        assert refused.certificate.reason == "contact"
        there = refused.certificate.place.configuration
        assert start[0] + 0.5 < there["root_joint.x"] < start[0] + 2.0
        assert there["root_joint.y"] == pytest.approx(start[1] - 1.6, abs=1e-6)
    assert smallest[1] == pytest.approx(smallest[0], abs=1e-7)


OF_JOINTS = ("start", "path", "positions", "configuration", "configurations", "start_configurations")
"""Fields of joint values, which those of a base are among."""

ELSEWHERE = {
    "obstacles, which scenes see": "Placed Sphere Polygon HalfSpace PointCloud ObstacleTrajectory",
    "in that of a link or object": "AttachedObject Attach.centre_of_mass Payload RelativeGoal OrientationCone.axis",
    "directions": "OrientationCone.target_axis PlaneConstraint.normal LineConstraint.direction LinkWrench.force "
    "LinkWrench.torque Dynamics.gravity PointPotentialReply.gradient Observation.velocity Observation.angular_velocity",
    "double precision in the world": "ForwardKinematics Jacobian Dynamics DynamicsReply ForwardKinematicsReply "
    "Potential.points",
    "joint values, which a placement doesn't change, and refused beyond 10 km": "Clearance.configurations "
    "Potential.configurations InverseKinematics.start_configurations InverseKinematicsReply.configurations "
    "StreamOpen.start StreamReply.start PieceTrajectory.positions",
    "rows and places of motions, as `_moved_columns` moves them": "CertifyRequest.path GivenTrajectory.positions "
    "PlanReply.path Trajectory.positions ExecutionFigures.positions Place.configuration",
    "by which a scene is changed before it is seen": "SceneDiff.move RequestScene.move",
    "observed in the world, less the stream's origin": "Observation.placement",
    "of whatever holds it": "Placement",
    "of a file": "UrdfFile.path",
}
"""Fields that speak of places, or look so, and aren't in the table of messages that are moved; and why."""


def kinds(annotation: Any) -> Iterator[Any]:
    """The classes and triples that a type is made of."""
    if typing.get_origin(annotation) is tuple and typing.get_args(annotation) == (float, float, float):
        yield tuple
    elif inspect.isclass(annotation):
        yield annotation
    for one in typing.get_args(annotation):
        yield from kinds(one)


def test_no_field_that_speaks_of_places_is_forgotten() -> None:
    told = {name for names in ELSEWHERE.values() for name in names.split()}
    found, forgotten = set(), []
    for module in pkgutil.iter_modules(messages.__path__):
        for name, kind in vars(importlib.import_module(f"guidefield.messages.{module.name}")).items():
            if not (inspect.isclass(kind) and issubclass(kind, msgspec.Struct) and kind.__name__ == name):
                continue
            for field, annotation in typing.get_type_hints(kind).items():
                of_places = {tuple, Placement, Float32Array}.intersection(kinds(annotation)) or field in OF_JOINTS
                if field not in kind.__struct_fields__ or not of_places or field in anchor.world_fields(kind):
                    continue
                known = {f"{name}.{field}", *(base.__name__ for base in kind.__mro__)} & told
                found |= known
                if not known:
                    forgotten.append(f"{name}.{field}")
    assert not forgotten, "is it of the world? Then the anchor has to move it; else say why not"
    assert found == told


def test_a_stream_far_away_is_that_at_home() -> None:
    pieces = []
    for place in ((0.0, 0.0, 0.0), PLACES[-1]):
        kite = StreamObstacle(Sphere(name="kite", radius=0.1), largest_speed=0.5)
        opened = StreamOpen(
            "ur5", cell(place), JointsGoal(GOAL), robot_placement=Placement(position=place), obstacles=[kite]
        )
        with Stream(opened) as stream:
            seen = Observation("kite", 0.0, Placement(position=there(place, 0.0, 1.2, 0.8)))
            pieces.append(stream.update(StreamUpdate(0.0, [seen])))
    assert np.array(pieces[1].trajectory.positions) == pytest.approx(np.array(pieces[0].trajectory.positions), abs=1e-6)


def test_positions_in_single_precision_are_warned_about() -> None:
    place = PLACES[-1]
    packed = PointCloud(
        name="scan", points=Float32Array(np.array([there(place, 2.0, 2.0, 2.0)], "<f4").tobytes()), radius=0.1
    )
    boxes = [Box(name="box", size=(0.1, 0.1, 0.1), position=(500_001.0, 4_000_001.0, 0.5))]
    for at, obstacles, told in (
        (place, [packed], "the points of 'scan' are in single precision, which has steps of 250 mm"),
        ((500_000.0, 4_000_000.0, 0.0), boxes, "all positions are in single precision"),
    ):
        asked = Clearance("ur5", Scene("s", obstacles=obstacles), [{}], robot_placement=Placement(position=at))
        assert any(told in warning for warning in answer(asked).warnings)
