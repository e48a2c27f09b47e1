"""The log of a run: all that its recording is rendered from, as bytes that are written before the reply is sent.

It holds the request, the planner's events, the reply and the motion, and robot and scene as they were then: a large
scene, its largest obstacles and a robot that a client stored are in files beside, which many logs share. A log lives
until it is rendered, perhaps by a newer version: a change of `_Log`, or of what it packs by the order of its fields
(`handlers/recording.py`, `EventLog`), that reads older logs wrongly needs another `MAGIC`.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.handlers.recording import PackedMotion
from guidefield.memo import memoized
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest, RobotReference, UrdfFile
from guidefield.messages.scene import Obstacle as ObstacleMessage, Scene as SceneMessage, Sphere
from guidefield.messages.values import RootJoint
from guidefield.planner.task.trace import EventLog, PackedEvents
from guidefield.robot.library import SentRobot
from guidefield.scene.anchor import Anchor
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene, declare_with
from guidefield.stores.recordings import OBSTACLES, ROBOT, SCENE, SharedFile
from guidefield.versions import describe_versions

MAGIC = b"guidefield run log 1\n"  # beginning of a log's file; the number is that of its form
LARGE_BYTES = 16 * 2**10  # a scene of more bytes, and an obstacle of more, is kept in a file of its own


class UnreadableLog(ValueError):
    """A log that nothing can be rendered from; says why in a few words."""


class _SentRobot(msgspec.Struct, frozen=True):
    """A robot that a client stored, as a file holds it; `paths` are those of its meshes when it was planned for."""

    urdf: str
    srdf: str | None
    root_joint: RootJoint
    meshes: dict[str, bytes]
    paths: dict[str, str]


class _StoredRobot(msgspec.Struct, frozen=True, tag="stored"):
    name: str
    content: str  # hash of its files


class _LocalRobot(msgspec.Struct, frozen=True, tag="local"):
    file: UrdfFile
    fingerprint: str


class _Log(msgspec.Struct, frozen=True):
    """A log as it is written, messages as MessagePack."""

    run_id: str
    made_with: str  # versions of packages, as `describe_versions`
    judges: bool  # whether the request is a CertifyRequest, else a PlanRequest
    request: bytes
    reply: bytes
    scene: bytes  # the scene, as MessagePack; empty: it is in a file of its own
    apart: tuple[int, ...]  # indices of its obstacles that are in files of their own, in the order of these
    scene_given: bool  # whether the request held the scene whole: `request` is written without it
    robot: _StoredRobot | _LocalRobot | None  # the robot, unless the request says all of it
    packages: tuple[str, ...]  # folders in which meshes of a robot that is sent as text are looked for
    events: PackedEvents
    motion: PackedMotion
    anchor: Anchor | None = None


@dataclass(frozen=True)
class RobotOrigin:
    """The source of a run's robot."""

    reference: RobotReference | SentRobot  # as the request has it, but of a stored robot its files
    fingerprint: str  # hash of its text and of its files' state
    packages: tuple[Path, ...]  # folders in which meshes of a robot that is sent as text are looked for


@dataclass(frozen=True)
class RunLog:
    """A log that was read: request, reply, planner's events and motion, and robot and scene as they were then."""

    run_id: str
    made_with: str
    request: MotionRequest
    reply: MotionReply
    robot: RobotOrigin
    scene: SceneMessage
    events: EventLog
    motion: PackedMotion
    anchor: Anchor | None = None


def write_log(
    run_id: str,
    request: MotionRequest,
    reply: MotionReply,
    robot: RobotOrigin,
    scene: Scene,
    events: EventLog,
    motion: PackedMotion,
    anchor: Anchor | None = None,
) -> tuple[bytes, list[SharedFile]]:
    """Return the content of a log, and the files that it shares with others."""
    packed = _pack_scene(scene)
    shared = [
        SharedFile(digest, ending, partial(_encode, scene.obstacles[index].message))
        for ending, (index, digest) in zip(OBSTACLES, packed.apart, strict=False)
    ]
    if packed.inline is None:
        shared.append(SharedFile(packed.digest, SCENE, lambda: _encode(_without(scene, packed.apart))))
    origin: _StoredRobot | _LocalRobot | None = None
    if isinstance(robot.reference, SentRobot):
        sent = robot.reference
        origin = _StoredRobot(sent.name, sent.content)
        shared.append(SharedFile(sent.content, ROBOT, lambda: _pack_robot(sent)))
    elif isinstance(robot.reference, UrdfFile):
        origin = _LocalRobot(robot.reference, robot.fingerprint)
    given = isinstance(request.scene, SceneMessage) and getattr(request.scene, "base", None) is None
    if given:  # it is packed apart
        request = copy.copy(request)  # without checking it again: it may name objects of its scene
        msgspec.structs.force_setattr(request, "scene", SceneMessage(name="scene"))
    log = _Log(
        run_id=run_id,
        made_with=describe_versions(),
        judges=isinstance(request, CertifyRequest),
        request=_encode(request),
        reply=_encode(reply),
        scene=packed.inline or b"",
        apart=tuple(index for index, _ in packed.apart),
        scene_given=given,
        robot=origin,
        packages=tuple(map(str, robot.packages)),
        events=events.pack(),
        motion=motion,
        anchor=anchor,
    )
    return MAGIC + _ENCODER.encode(log), shared


def read_log(data: bytes, needed: Callable[[str], Path], make_folder: Callable[[], Path]) -> RunLog:
    """Read a log with the files that it shares.

    Args:
        needed: Returns the path of a shared file by the ending of the log's link to it.
        make_folder: Makes a folder for the meshes of a stored robot whose files are gone.

    Raises:
        UnreadableLog: if it is damaged, or of another version of guidefield.
        OSError: if the disk refuses.
    """
    if not data.startswith(MAGIC):
        raise UnreadableLog("its log is damaged, or was written by another version of guidefield")
    try:
        log = msgspec.msgpack.decode(data[len(MAGIC) :], type=_Log)
        declared = _scene(log, needed)
        decode = msgspec.msgpack.decode
        request: MotionRequest = decode(log.request, type=CertifyRequest if log.judges else PlanRequest)
        reply: MotionReply = decode(log.reply, type=CertifyReply if log.judges else PlanReply)
        if log.scene_given:
            msgspec.structs.force_setattr(request, "scene", declared)
        reference: RobotReference | SentRobot = request.robot
        if isinstance(log.robot, _StoredRobot):
            reference = _unpack_robot(log.robot, needed(ROBOT), make_folder)
        elif isinstance(log.robot, _LocalRobot):
            reference = log.robot.file
        fingerprint = log.robot.fingerprint if isinstance(log.robot, _LocalRobot) else ""
        return RunLog(
            run_id=log.run_id,
            made_with=log.made_with,
            request=request,
            reply=reply,
            robot=RobotOrigin(reference, fingerprint, tuple(map(Path, log.packages))),
            scene=declared,
            events=EventLog.unpack(log.events),
            motion=log.motion,
            anchor=log.anchor,
        )
    except FileNotFoundError as error:
        raise UnreadableLog(f"its log lacks {Path(error.filename).name}") from None
    except (msgspec.DecodeError, MalformedRequest, ValueError, LookupError, TypeError) as error:
        raise UnreadableLog(f"its log is damaged: {error}") from None


def made_with_of(log: Path) -> str:
    """Return the versions of packages that the run of a log was made with; empty if it can't be read."""
    with contextlib.suppress(OSError, msgspec.DecodeError):
        data = log.read_bytes()
        if data.startswith(MAGIC):
            return msgspec.msgpack.decode(data[len(MAGIC) :], type=_MadeWith).made_with
    return ""


class _MadeWith(msgspec.Struct):
    made_with: str


_ENCODER = msgspec.msgpack.Encoder()


def _encode(message: msgspec.Struct) -> bytes:
    return codec.encode(message, Encoding.MSGPACK)


class _PackedScene(NamedTuple):
    digest: str
    inline: bytes | None  # the scene; None if it is large, and in a file of its own
    apart: tuple[tuple[int, str], ...]  # indices of large obstacles and hashes of their files


@memoized
def _pack_scene(scene: Scene) -> _PackedScene:
    """Pack a scene without its largest obstacles, which most versions of a scene share."""
    sizes = [(*_measure_obstacle(scene.obstacles[index]), index) for index in scene.others]
    large = sorted((one for one in sizes if one[0] > LARGE_BYTES), reverse=True)[: len(OBSTACLES)]
    apart = tuple((index, digest) for _, digest, index in large)
    packed = _encode(_without(scene, apart))
    return _PackedScene(_hash(packed), packed if len(packed) <= LARGE_BYTES else None, apart)


@memoized
def _measure_obstacle(obstacle: Obstacle) -> tuple[int, str]:
    packed = _encode(obstacle.message)
    return len(packed), _hash(packed)


def _without(scene: Scene, apart: Sequence[tuple[int, str]]) -> SceneMessage:
    """Return the message of a scene with a sphere in place of each obstacle that is kept apart."""
    obstacles = [one.message for one in scene.obstacles]
    for index, _ in apart:
        obstacles[index] = Sphere(name=obstacles[index].name, radius=1.0)
    return declare_with(scene.message, obstacles)


def _scene(log: _Log, needed: Callable[[str], Path]) -> SceneMessage:
    declared = msgspec.msgpack.decode(log.scene or needed(SCENE).read_bytes(), type=SceneMessage)
    obstacles = list(declared.obstacles)
    for index, ending in zip(log.apart, OBSTACLES, strict=False):
        obstacles[index] = msgspec.msgpack.decode(needed(ending).read_bytes(), type=ObstacleMessage)
    return declare_with(declared, obstacles)


def _hash(packed: bytes) -> str:
    return hashlib.blake2b(packed, digest_size=32).hexdigest()


def _pack_robot(sent: SentRobot) -> bytes:
    meshes = {uri: path.read_bytes() for uri, path in sent.meshes.items()}
    paths = {uri: str(path) for uri, path in sent.meshes.items()}
    return _ENCODER.encode(_SentRobot(sent.urdf, sent.srdf, sent.root_joint, meshes, paths))


def _unpack_robot(stored: _StoredRobot, file: Path, make_folder: Callable[[], Path]) -> SentRobot:
    """Return a stored robot with the store's meshes, which are drawn already, or with those of the file."""
    packed = msgspec.msgpack.decode(file.read_bytes(), type=_SentRobot)
    meshes = {uri: Path(path) for uri, path in packed.paths.items()}
    if not all(path.exists() for path in meshes.values()):
        folder = make_folder()
        meshes = {uri: folder / path.name for uri, path in meshes.items()}
        for uri, path in meshes.items():
            path.write_bytes(packed.meshes[uri])
    return SentRobot(stored.name, stored.content, packed.urdf, packed.srdf, meshes, packed.root_joint)
