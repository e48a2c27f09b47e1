"""A stream in the caller's process: robots and scenes by name, no network, no clock but the caller's.

`Stream` is public: it counts work instead of reading a clock, so that the same updates give the same bits.
"""

from __future__ import annotations

import logging
from typing import Any, cast

import msgspec

from guidefield.first_start import compile_kernels
from guidefield.messages import codec
from guidefield.messages.scene import Scene as SceneMessage
from guidefield.messages.scene_changes import RequestScene, apply_change
from guidefield.messages.streams import StreamOpen
from guidefield.robot.catalog import Catalog
from guidefield.scene.scene import build
from guidefield.stores.scenes import PackagedScenes
from guidefield.stream.stream import CertifiedStream

_log = logging.getLogger(__name__)


class Stream(CertifiedStream):
    """Certified motion among obstacles that move: what is seen goes in, pieces come out, each with a proven stop.

    The caller's clock drives it: it reads none, counts its work, and gives the same pieces for the same updates, bit
    for bit. It is not for two threads. docs/stream.md says what is promised, and what is not.

    Args:
        request: A `StreamOpen` or the same as a dict; or its fields by name.
        fields: As in `StreamOpen`.

    Raises:
        GuidefieldError: if the request is ill-posed.

    Examples:
        >>> import guidefield
        >>> goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
        >>> kite = {"obstacle": {"type": "sphere", "name": "kite", "radius": 0.1}, "largest_speed": 0.5}
        >>> stream = guidefield.Stream(robot="ur5", scene="table", goal=goal, obstacles=[kite])
        >>> seen = {"name": "kite", "time": 0.0, "placement": {"position": [0.0, 1.2, 0.8]}}
        >>> piece = stream.update(time=0.0, obstacles=[seen])
        >>> piece.begins, piece.brakes, piece.follows
        (0.02, 0.05, 0)
        >>> stream.close()
    """

    def __init__(self, request: StreamOpen | dict[str, Any] | None = None, /, **fields: Any) -> None:
        if not isinstance(request, StreamOpen) or fields:
            given = msgspec.to_builtins(request) if isinstance(request, StreamOpen) else (request or {})
            request = cast(StreamOpen, codec.convert({**given, **codec.plain_fields(fields)}, StreamOpen))
        compile_kernels(_log.warning)
        robot = Catalog().load(request.robot)
        super().__init__(request, robot, build(_resolve_scene(request)))


def _resolve_scene(request: StreamOpen) -> SceneMessage:
    reference = request.scene
    if isinstance(reference, str):
        return PackagedScenes().read(reference)[0]
    if not isinstance(reference, RequestScene) or reference.base is None:
        return reference
    return apply_change(PackagedScenes().read(reference.base, reference.version)[0], reference, reference.name)
