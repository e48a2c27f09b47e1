"""Read requests in any form; a large scene is decoded once and then found by a hash of its bytes, as the same object.

It is frozen with this hash as its content, by which scene/scene.py finds what was built of it. A scene that is to be
stored, or has a base, is decoded each time.
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from guidefield.bounded_map import READ_SCENES, BoundedMap, content_key
from guidefield.collector import pause_collector
from guidefield.messages import codec, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import FrozenFacts, RequestScene, freeze

MIN_HASHED_BYTES = 2**13
"""Smaller scenes are decoded each time, which takes a tenth of a millisecond."""

MANY_OBJECTS_BYTES = 2**16
"""Size from which decoding makes more than a thousand long-lived objects, so that the garbage collector waits."""

_SCENES: BoundedMap[bytes, Scene] = BoundedMap(READ_SCENES)


def read_payload(data: bytes, kind: Any, encoding: Encoding) -> Any:
    """Decode a request of a kind, or by its tag, as `codec.decode`; a large scene that was decoded before is reused."""
    fields: Mapping[str, msgspec.Raw] = {}
    if len(data) >= MIN_HASHED_BYTES:
        fields = codec.split_fields(data, encoding)
    if kind is None:
        kind = codec.request_kind(b'{"type":%s}' % fields.get("type", b"null") if fields else data)
    scene = fields.get("scene", b"")
    return _read(
        scene if len(scene) >= MIN_HASHED_BYTES else None,
        lambda: codec.decode(data, kind, encoding),
        lambda stand_in: codec.decode(codec.encode({**fields, "scene": stand_in}, encoding), kind, encoding),
        len(data),
    )


def read_request(request: bytes | dict[str, Any] | requests.Request) -> requests.Request:
    """Read and check a request in any form: JSON, plain data or a message; raises as `codec.decode_request`.

    A large scene with the content of an earlier one is reused: arrays in it are compared by their bytes.
    """
    made: requests.Request
    if type(request) is bytes:
        made = read_payload(request, None, Encoding.JSON)
        return made
    if not isinstance(request, dict | msgspec.Struct):
        return codec.decode_request(request)
    scene = _pack_scene(_get(request, "scene"))
    made = _read(
        scene if scene is not None and len(scene) >= MIN_HASHED_BYTES else None,
        lambda: _convert(request),
        lambda stand_in: _convert(_with_fields(request, {"scene": stand_in})),
        len(scene or b""),
    )
    return made


def _read(
    scene: bytes | msgspec.Raw | None, read_all: Callable[[], Any], read_rest: Callable[[Any], Any], size: int
) -> Any:
    """Read all of a request, or the rest with another scene: one read before with the same bytes, if it is large."""
    digest = None if scene is None else content_key(scene)
    known = None if digest is None else _SCENES.get(digest)
    if known is not None:
        made = read_rest({"name": known.name})
        if not isinstance(made, requests.StoreScene):
            msgspec.structs.force_setattr(made, "scene", known)
            return made
    with pause_collector() if size >= MANY_OBJECTS_BYTES else contextlib.nullcontext():
        made = read_all()
    read = getattr(made, "scene", None)
    if scene is None or digest is None or not isinstance(read, Scene) or isinstance(made, requests.StoreScene):
        return made
    if not (isinstance(read, RequestScene) and read.base):
        _SCENES.insert(digest, freeze(read, FrozenFacts(content=digest)), len(scene))
    return made


def _pack_scene(scene: Any) -> bytes | None:
    if not isinstance(scene, dict | Scene):
        return None
    try:
        packed: bytes = _HASHED.encode(scene)
    except (TypeError, ValueError, OverflowError, RecursionError):  # reading it says what is wrong
        return None
    return packed


def _pack_array_bytes(value: Any) -> Any:
    """Return kind, shape and bytes of an array in a form that no payload has; a NumPy number becomes Python's."""
    if not hasattr(value, "tolist"):
        raise TypeError(f"{type(value).__name__} is nothing that a scene holds")
    if not getattr(value, "shape", None):
        return value.tolist()
    view = memoryview(value)
    if view.format not in _NUMBERS:
        raise TypeError(f"an array of format {view.format!r} isn't one of numbers")
    content = view.cast("B") if view.c_contiguous and view.nbytes else value.tobytes()
    return [msgspec.msgpack.Ext(1, f"{view.format} {view.shape}".encode()), content]


_NUMBERS = frozenset("bBhHiIlLqQfd")
"""Formats of arrays that are equal if their bytes are."""

_HASHED = msgspec.msgpack.Encoder(enc_hook=_pack_array_bytes)


def _convert(request: Any) -> requests.Request:
    """Read a request in Python; pack its arrays of points and triangles, and check messages in a dict."""
    fields = dict[str, Any]()
    if isinstance(scene := _get(request, "scene"), dict | msgspec.Struct):
        lists = {name: _get(scene, name) for name in ("obstacles", "add")}
        fields["scene"] = _with_fields(scene, {name: _pack_each(some) for name, some in lists.items() if some})
    if isinstance(held := _get(request, "attached_objects"), list | tuple):
        fields["attached_objects"] = [_pack_held(one) for one in held]
    request = _with_fields(request, fields)
    if isinstance(request, dict):
        scene = request.get("scene")
        if isinstance(scene, dict):
            request["scene"] = {name: _to_plain(value) for name, value in scene.items()}
        return codec.decode_request({name: _to_plain(value) for name, value in request.items()})
    return codec.decode_request(codec.replace_arrays(request))


def _to_plain(value: Any) -> Any:
    some = value if isinstance(value, list | tuple) else (value,)
    return codec.replace_arrays(value) if any(isinstance(one, msgspec.Struct) for one in some) else value


def _pack_held(attached: Any) -> Any:
    obstacle = _get(attached, "obstacle")
    return _with_fields(attached, {"obstacle": _to_plain(_pack_arrays(obstacle))}) if obstacle else attached


def _pack_each(obstacles: Any) -> Any:
    return [*map(_pack_arrays, obstacles)] if isinstance(obstacles, list | tuple) else obstacles


def _pack_arrays(obstacle: Any) -> Any:
    """Replace arrays of points and triangles by packed ones of the same numbers: a hundred times faster than lists."""
    arrays = {field: _get(obstacle, field) for field in ("vertices", "triangles", "points")}
    packed = {
        field: found
        for field, array in arrays.items()
        if hasattr(array, "dtype") and (found := _pack(array, field == "triangles")) is not None
    }
    return _with_fields(obstacle, packed)


def _pack(array: Any, are_triangles: bool) -> dict[str, bytes] | None:
    """Pack triples of float32, or of integers if they are triangles; return None for other arrays."""
    kind = array.dtype.str[1:]
    if array.shape[1:] != (3,) or not len(array):
        return None
    if not are_triangles:
        return {"float32": array.astype("<f4").tobytes()} if kind == "f4" else None
    if kind not in ("i4", "i8", "u4", "u8") or array.min() < 0 or array.max() >= 2**32:
        return None
    return {"uint32": array.astype("<u4").tobytes()}


def _get(holder: Any, field: str) -> Any:
    return holder.get(field) if isinstance(holder, dict) else getattr(holder, field, None)


def _with_fields(holder: Any, fields: dict[str, Any]) -> Any:
    if not fields:
        return holder
    if isinstance(holder, dict):
        return {**holder, **fields}
    other = copy.copy(holder)
    for field, value in fields.items():
        msgspec.structs.force_setattr(other, field, value)
    return other
