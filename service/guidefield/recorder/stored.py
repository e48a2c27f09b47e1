"""Recordings in a store, without what all runs share, and those that leave it: one file that anybody can open.

A stored recording lacks its robot's meshes, which lie once beside all runs, its layout, which follows from it, and a
large scene, whose file is named by its content and has its obstacles, drawn, and its message. Each recording holds on
to that by a hard link beside itself, so that the file goes with the last recording that needs it.
"""

from __future__ import annotations

import errno
import functools
import hashlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import rerun as rr
from rerun.chunk import Chunk

from guidefield.memo import memoized
from guidefield.messages.requests import MotionRequest
from guidefield.recorder import bodies, scene_entities, surface
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import encode_recording, still, visible_entities, write_recording
from guidefield.recorder.documents import (
    LARGE_BYTES,
    MESSAGE_COMPONENT,
    SCENE,
    encode,
    large_scene,
    pack,
)
from guidefield.recorder.reading import LINK, left_out
from guidefield.recorder.view import Eye, layout
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene, declare_with
from guidefield.whole_file import link_shared, remove_unshared

FOLDER = "runs-scenes"  # name of the folder of these files, beside that of the robots
UNUSED_S = 3600.0  # age from which a file without a link goes [s]


@dataclass(frozen=True, eq=False)
class SharedScene:
    """The part of a recording that is the same for many runs, by the hash of all that it is made of."""

    digest: str
    is_large: bool
    chunks: Callable[[], Sequence[Chunk]]

    def link(self, recording: Path, bodies: Path) -> bool:
        """Link a recording to the file, made if need be beside its robots; False where the disk has no such links."""
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
    """Return the scene of a run as its recording shows it; the request's goes in too where it is large."""
    seen, hit = (scene.names.intersection(names) for names in (see_through, at_fault))
    size, content = _content(scene)
    message = large_scene(request)
    names = f"{sorted(seen)} {sorted(hit)}".encode()
    digest = hashlib.sha256(_readers())
    for part in (content, b"" if message is None else encode(message), names):
        digest.update(hashlib.sha256(part).digest())

    def draw_large() -> list[Chunk]:
        drawn = list(scene_entities.obstacles(scene.obstacles, seen, hit))
        if message is not None:
            drawn.append(still(SCENE, rr.AnyValues(**{MESSAGE_COMPONENT: pack(message)})))
        return drawn

    is_large = message is not None or size >= LARGE_BYTES
    draw = draw_large if is_large else partial(_draw_small, scene, seen, hit)
    return SharedScene(digest.hexdigest()[:32], is_large, draw)


@memoized
def _draw_small(scene: Scene, see_through: frozenset[str], at_fault: frozenset[str]) -> tuple[Chunk, ...]:
    return tuple(scene_entities.obstacles(scene.obstacles, see_through, at_fault))


@memoized
def _content(scene: Scene) -> tuple[int, bytes]:
    """Size of a scene's obstacles [bytes] and a hash of all that they are drawn by, which motions are not."""
    moving = [index for index in scene.others if scene.obstacles[index].motion is not None]
    declared = list(scene.message.obstacles)
    for index in moving:
        declared[index] = msgspec.structs.replace(declared[index], trajectory=None)
    content = encode(declare_with(scene.message, declared))
    return len(content), hashlib.sha256(content + f"{moving}".encode()).digest()


@functools.cache
def _readers() -> bytes:
    """The code that draws: a file drawn by another version has another name."""
    files = (__file__, bodies.__file__, scene_entities.__file__, surface.__file__)
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
