"""Write recordings for a store without parts that runs share, make whole ones of these, and read their messages back.

A stored recording lacks its robot's meshes, of which there is one file for all runs, its layout, and a large scene,
whose file is named by its content and has its obstacles, drawn, and its message. Each recording has a hard link to that
file beside itself, so that the file system deletes it with the last recording that needs it. Recordings of earlier
versions must stay readable: names of entities and components, and endings, stay.
"""

from __future__ import annotations

import errno
import functools
import hashlib
import logging
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.memo import memoized
from guidefield.messages.replies import CERTIFY, CertifyReply, MotionReply, PlanReply, RequestTag
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.messages.scene import Scene as SceneMessage
from guidefield.recorder import bodies, entities, surface
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import (
    UNREADABLE,
    encode_recording,
    read_chunks,
    read_meshes,
    still,
    visible_entities,
    write_recording,
)
from guidefield.recorder.documents import (
    LARGE_BYTES,
    MADE_WITH,
    MESSAGE_COMPONENT,
    PROPERTIES,
    REPLY,
    REQUEST,
    SCENE,
    encode,
    large_scene,
    pack,
    unpack,
    with_warning,
)
from guidefield.recorder.view import Eye, layout
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene, declare_with
from guidefield.versions import parse_versions
from guidefield.whole_file import link_shared, remove_unshared

LEFT_OUT = "/left_out"  # entity with the names of the parts that a stored recording lacks
LINK = ".drawn"  # ending of a stored recording's link to the file of its scene: `SCENE_LINK` of `stores/recordings.py`

_log = logging.getLogger(__name__)


def left_out(meshes: str, eye: Eye, timeline: str, *, scene_too: bool) -> Chunk:
    """Make the chunk that names the parts a stored recording lacks: file of meshes, layout, perhaps the scene."""
    at = np.concatenate([eye.position, eye.target])
    return still(LEFT_OUT, rr.AnyValues(meshes=meshes, eye=at, timeline=timeline, scene_apart=[scene_too]))


def self_contained(recording: Path, folder: Path) -> bytes:
    """Return a run's recording with its scene, its layout and its robot's meshes, from a folder, as one file.

    If a file of scene or meshes is missing or damaged, the recording lacks that; its summary and the log say so.

    Raises:
        OSError: if the recording can't be read.
        ValueError, KeyError, RuntimeError: if it isn't whole.
    """
    reader = RrdReader(recording)
    (store,) = reader.recordings()
    chunks = reader.stream().to_chunks()
    lacking = next((chunk for chunk in chunks if chunk.entity_path == LEFT_OUT), None)
    if lacking is None:
        return recording.read_bytes()
    batch = lacking.to_record_batch()
    (name,), at, (timeline,) = (batch.column(part).to_pylist()[0] for part in ("meshes", "eye", "timeline"))
    rest = [chunk for chunk in chunks if chunk.entity_path != LEFT_OUT]
    views = layout(Eye(np.array(at[:3]), np.array(at[3:]), frozenset()), timeline, visible_entities(rest))
    rest = _with(rest, "the robot's meshes are", lambda: read_meshes(folder / Path(name).name))
    if (
        "scene_apart" in batch.schema.names and batch.column("scene_apart").to_pylist()[0][0]
    ):  # those of old versions have none
        rest = _with(rest, "the scene is", lambda: read_chunks(recording.with_suffix(LINK)))
    return encode_recording(store.recording_id, rest, views)


def _with(chunks: Sequence[Chunk], what: str, read: Callable[[], list[Chunk]]) -> list[Chunk]:
    """Add the chunks that are read to those of a recording, or a warning if they can't be read."""
    try:
        return [*chunks, *read()]
    except UNREADABLE as error:
        _log.warning("%s missing from a recording: %s", what, error)
        return with_warning(chunks, f"{what} not in this recording: the file is missing or damaged")


@dataclass(frozen=True)
class Recorded:
    """The exact messages in a recording, and the versions of packages, Python and ``processor``."""

    request: MotionRequest
    reply: MotionReply
    versions: dict[str, str]


def read_recording(path: Path) -> Recorded:
    """Read a recording's messages.

    Raises UnknownObject if there is no such file; MalformedRequest if it is no whole recording of guidefield.
    """
    if not path.is_file():
        raise UnknownObject(f"there is no recording {str(path)!r}", path=str(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is wrong with a file is raised below, in one sentence
            chunks = RrdReader(str(path)).stream().filter(content=["/documents/**", "/__properties/**"])
            found = {chunk.entity_path: chunk for chunk in chunks}
        (packages,) = _values(found[PROPERTIES], MADE_WITH)
        request, reply = (bytes(_values(found[path], MESSAGE_COMPONENT)) for path in (REQUEST, REPLY))
        certifies = unpack(request, RequestTag).type == CERTIFY
        motion_request: MotionRequest = unpack(request, CertifyRequest) if certifies else unpack(request, PlanRequest)
        if "scene_apart" in found[REQUEST].to_record_batch().schema.names:
            if SCENE not in found:  # it is in the file that a recording in a store is linked to
                (found[SCENE],) = RrdReader(str(path.with_suffix(LINK))).stream().filter(content=[SCENE])
            scene = unpack(bytes(_values(found[SCENE], MESSAGE_COMPONENT)), SceneMessage)
            motion_request = msgspec.structs.replace(motion_request, scene=scene)
        answered: MotionReply = unpack(reply, CertifyReply) if certifies else unpack(reply, PlanReply)
        return Recorded(motion_request, answered, parse_versions(packages))
    except (RuntimeError, ValueError, LookupError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else f"{error}"
        what = f"{path.name!r} is no whole recording of guidefield, or one of another version"
        raise MalformedRequest(f"{what}: {why}", path=str(path)) from None


def _values(chunk: Chunk, component: str) -> list[Any]:
    (row,) = chunk.to_record_batch().column(component).to_pylist()
    return list(row)


FOLDER = "runs-scenes"  # name of the folder of scenes' files, beside that of the robots
UNUSED_S = 3600.0  # age from which a scene's file without a link is deleted, long after its writer linked it [s]


@dataclass(frozen=True, eq=False)
class SharedScene:
    """The scene of a recording, which many runs may share."""

    digest: str  # hash of all that its file shows, and of the code that draws it: runs of one digest share the file
    is_large: bool  # whether it has a file of its own in a store
    chunks: Callable[[], Sequence[Chunk]]

    def link(self, recording: Path, bodies: Path) -> bool:
        """Link a recording to the scene's file, which is made if need be; False if the disk has no hard links."""
        folder, link = bodies.with_name(FOLDER), recording.with_suffix(LINK)

        def content() -> bytes:
            remove_unshared(folder, UNUSED_S)
            return encode_recording(self.digest, self.chunks(), None)

        link.unlink(missing_ok=True)
        try:
            link_shared(link, folder / f"{self.digest}.rrd", content)
        except OSError as error:
            if error.errno in (errno.EPERM, errno.EOPNOTSUPP, errno.EXDEV):
                return False
            raise
        return True


def shared_scene(
    scene: Scene, request: MotionRequest, see_through: Collection[str], at_fault: Collection[str]
) -> SharedScene:
    """Return the scene of a run as its recording shows it, with the request's message of it if that is large."""
    seen, hit = (scene.names.intersection(names) for names in (see_through, at_fault))
    size, content = _content(scene)
    message = large_scene(request)
    names = f"{sorted(seen)} {sorted(hit)}".encode()
    digest = hashlib.sha256(_drawing_code())
    for part in (content, b"" if message is None else encode(message), names):
        digest.update(hashlib.sha256(part).digest())

    def draw_large() -> list[Chunk]:
        drawn = list(entities.obstacles(scene.obstacles, seen, hit))
        if message is not None:
            drawn.append(still(SCENE, rr.AnyValues(**{MESSAGE_COMPONENT: pack(message)})))
        return drawn

    is_large = message is not None or size >= LARGE_BYTES
    draw = draw_large if is_large else partial(_draw_small, scene, seen, hit)
    return SharedScene(digest.hexdigest()[:32], is_large, draw)


@memoized
def _draw_small(scene: Scene, see_through: frozenset[str], at_fault: frozenset[str]) -> tuple[Chunk, ...]:
    return tuple(entities.obstacles(scene.obstacles, see_through, at_fault))


@memoized
def _content(scene: Scene) -> tuple[int, bytes]:
    """Return the size of a scene's message [bytes] and a hash of what is drawn of it: all but obstacles' motions."""
    moving = [index for index in scene.others if scene.obstacles[index].motion is not None]
    declared = list(scene.message.obstacles)
    for index in moving:
        declared[index] = msgspec.structs.replace(declared[index], trajectory=None)
    content = encode(declare_with(scene.message, declared))
    return len(content), hashlib.sha256(content + f"{moving}".encode()).digest()


@functools.cache
def _drawing_code() -> bytes:
    """Return the code that draws, so that a file drawn by another version has another name."""
    files = (__file__, bodies.__file__, entities.__file__, surface.__file__)
    return b"".join([rr.__version__.encode(), *(Path(file).read_bytes() for file in files)])


@dataclass(frozen=True)
class RecordingPlace:
    """The place of a recording: whole, or for a store, without its robot's meshes and layout."""

    file: Path  # the recording
    bodies: Path  # folder of robots that are kept prepared
    whole: bool  # whether the robot's meshes and the layout are put into the recording

    def write(
        self,
        run_id: str,
        chunks: Sequence[Chunk],
        scene: SharedScene,
        robot: RobotModel,
        drawn: Drawn,
        eye: Eye,
        timeline: str,
    ) -> None:
        """Write the chunks of a run with its scene and robot; raises OSError, and leaves nothing, if that fails."""
        if not self.whole:
            linked = scene.is_large and scene.link(self.file, self.bodies)
            rest = [] if linked else scene.chunks()
            lacking = left_out(drawn.file.name, eye, timeline, scene_too=linked)
            try:
                write_recording(self.file, run_id, [*chunks, *rest, lacking], None)
            except OSError:
                self.file.with_suffix(LINK).unlink(missing_ok=True)
                raise
            return
        present = visible_entities(chunks)
        every = [*chunks, *scene.chunks(), *bodies.meshes(robot, drawn)]
        write_recording(self.file, run_id, every, layout(eye, timeline, present))
