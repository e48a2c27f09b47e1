"""Decode requests and encode replies; a large scene is decoded once and then found by a hash of its bytes.

It is frozen with this hash as its content, by which scene/scene.py finds what was built of it. A scene that is to be
stored, or has a base, is decoded each time.
"""

from __future__ import annotations

import contextlib
import copy
import enum
import functools
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from guidefield.errors import MalformedRequest, RequestTooLarge
from guidefield.memory import READ_SCENES, BoundedMap, content_key, pause_collector
from guidefield.messages import faults, requests
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import FrozenFacts, RequestScene, freeze

MAX_REQUEST_BYTES = 64 * 2**20
"""Largest payload that is decoded; a larger one is refused as too large.

docs/wire.md tells it: after a change, `tools/wire_page`. `endpoint/link.py` lets messages of four times this through.
"""

MAX_EXPLAINED_BYTES = 2**20
"""Largest payload that is decoded again after a fault, to list the valid choices."""


class Encoding(enum.StrEnum):
    """The encoding of a payload; the values are its MIME types."""

    JSON = "application/json"
    MSGPACK = "application/msgpack"


class TypeTag(msgspec.Struct):
    """The field that says which message it is; a plan request and a scene have none."""

    type: str | None = None


def _convert_array(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__!r} is neither a number, a text, a list nor a dict")


_ENCODERS: dict[Encoding, Any] = {
    Encoding.JSON: msgspec.json.Encoder(enc_hook=_convert_array),
    Encoding.MSGPACK: msgspec.msgpack.Encoder(enc_hook=_convert_array),
}


@functools.cache
def _decoder(kind: Any, encoding: Encoding) -> Any:
    return msgspec.json.Decoder(kind) if encoding is Encoding.JSON else msgspec.msgpack.Decoder(kind)


for _kind in (
    TypeTag,
    requests.PlanRequest,
    requests.CertifyRequest,
    requests.KinematicsRequest,
    requests.TaggedRequest,
    requests.RobotFiles,
    Scene,
):
    for _encoding in Encoding:
        _decoder(_kind, _encoding)


def decode(data: bytes, kind: Any, encoding: Encoding = Encoding.JSON) -> Any:
    """Decode one message of a known kind, or of a union of tagged ones.

    Raises:
        RequestTooLarge: if the payload is longer than `MAX_REQUEST_BYTES`.
        MalformedRequest: if it isn't such a message; names the path of the first fault.
    """
    require_size(len(data))
    try:
        return _decoder(kind, encoding).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _make_decode_error(error, data, kind, encoding) from None


def split_fields(data: bytes, encoding: Encoding) -> dict[str, msgspec.Raw]:
    """Return the bytes of each field of a message; no fields if the data is malformed; raises as `require_size`."""
    require_size(len(data))
    try:
        fields: dict[str, msgspec.Raw] = _decoder(dict[str, msgspec.Raw], encoding).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return {}
    return fields


def require_size(size: int) -> None:
    """Raise RequestTooLarge for a payload longer than `MAX_REQUEST_BYTES`."""
    if size > MAX_REQUEST_BYTES:
        raise RequestTooLarge(
            f"the request has {size} bytes, at most {MAX_REQUEST_BYTES} are read", bytes=size, limit=MAX_REQUEST_BYTES
        )


def decode_request(request: bytes | str | dict[str, Any] | requests.Request) -> requests.Request:
    """Decode a request in any form: JSON, plain data, or a Struct; one without a `type` is a plan request."""
    if isinstance(request, msgspec.Struct):
        return request
    if isinstance(request, dict):
        converted: requests.Request = convert(
            request, requests.TaggedRequest if "type" in request else requests.PlanRequest
        )
        return converted
    if not isinstance(request, bytes | bytearray | memoryview | str):
        raise MalformedRequest(f"a request is JSON, a dict or a message, not {type(request).__name__}", path="$")
    if isinstance(request, str):
        request = request.encode(errors="replace")
    decoded: requests.Request = decode(request, request_kind(request), Encoding.JSON)
    return decoded


def request_kind(request: bytes) -> Any:
    """Return the class of a request in JSON: of a plan request, or the union of all tagged requests."""
    tag = decode(request, TypeTag, Encoding.JSON)
    return requests.PlanRequest if tag.type is None else requests.TaggedRequest


def convert(plain: Any, kind: Any) -> Any:
    """Convert plain data, which may contain NumPy's numbers and arrays, to a message, a tagged one or a list of some.

    Raises:
        MalformedRequest: if it isn't such a message; names the path of the first fault.
    """
    try:
        try:
            return msgspec.convert(plain, kind)
        # msgspec 0.23 asks whatever has items for those of a message, an array too, which says that it has no such.
        except (msgspec.ValidationError, LookupError, TypeError, ValueError):
            plain = replace_arrays(plain)
            return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        raise _make_refusal(error, plain, kind) from None


def plain_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Return fields of a message by name as plain data; messages in them become dicts."""
    return {name: msgspec.to_builtins(value, enc_hook=_convert_array) for name, value in fields.items()}


def replace_arrays(request: Any) -> Any:
    """Return a request, or a part, as plain data; NumPy's numbers and arrays, and all with `tolist`, are listed."""
    try:
        return msgspec.to_builtins(request, builtin_types=(bytes,), enc_hook=_convert_array)
    except TypeError as error:
        raise MalformedRequest(f"the request holds what no message can: {error}", path="$") from None


def encode(message: object, encoding: Encoding = Encoding.JSON) -> bytes:
    """Encode a reply, or any message."""
    encoded: bytes = _ENCODERS[encoding].encode(message)
    return encoded


def _make_decode_error(error: Exception, data: bytes, kind: Any, encoding: Encoding) -> MalformedRequest:
    is_explained = encoding is Encoding.JSON and len(data) <= MAX_EXPLAINED_BYTES
    if isinstance(error, msgspec.ValidationError):
        if is_explained and (found := faults.find_number_out_of_range(data)) is not None:
            path, said = found
            message = f"`{path.rpartition('.')[2]}` must be a finite number, got {said[: faults.MAX_QUOTED_CHARACTERS]}"
            return MalformedRequest(f"{message} (at {path})", path=path)
        return _make_refusal(error, _decode_plain(data, encoding), kind)
    if is_explained and (found := faults.find_nonfinite_word(data)) is not None:
        path, said = found
        place = faults.locate_in_text(str(error), data).rpartition(" (")[2]
        hint = f"{said} is no number of JSON, a finite one is needed"
        return MalformedRequest(f"the payload is not {encoding.value}: {hint} ({place} (at {path})", path=path)
    text = faults.locate_in_text(str(error), data) if encoding is Encoding.JSON else str(error)
    return MalformedRequest(f"the payload is not {encoding.value}: {text}", path="$")


def _decode_plain(data: bytes, encoding: Encoding) -> Any:
    """Return a payload as plain data; None if it is too large, or malformed after its first fault."""
    try:
        return _decoder(Any, encoding).decode(data) if len(data) <= MAX_EXPLAINED_BYTES else None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def _make_refusal(error: msgspec.ValidationError, data: Any, kind: Any) -> MalformedRequest:
    if data is None:
        message, path = faults.split_message(str(error))
        path = faults.field_path(message, path)
        return MalformedRequest(f"{message} (at {path})", path=path)
    check = functools.partial(msgspec.convert, type=kind)
    message, path, choices = faults.explain(str(error), data, kind, check)
    path = faults.field_path(message, path)
    if path == "$.type" and kind is requests.TaggedRequest:
        message += "; a plan request has no `type`"
    return MalformedRequest(f"{message} (at {path})", path=path, **({"available": choices} if choices else {}))


MIN_HASHED_BYTES = 2**13
"""Smaller scenes are decoded each time, which takes a tenth of a millisecond."""

MANY_OBJECTS_BYTES = 2**16
"""Size from which decoding makes more than a thousand long-lived objects, so that the garbage collector waits."""

_SCENES: BoundedMap[bytes, Scene] = BoundedMap(READ_SCENES)


def read_payload(data: bytes, kind: Any, encoding: Encoding) -> Any:
    """Decode a request of a kind, or by its tag, as `decode`; a large scene that was decoded before is reused."""
    fields: Mapping[str, msgspec.Raw] = {}
    if len(data) >= MIN_HASHED_BYTES:
        fields = split_fields(data, encoding)
    if kind is None:
        kind = request_kind(b'{"type":%s}' % fields.get("type", b"null") if fields else data)
    scene = fields.get("scene", b"")
    return _read(
        scene if len(scene) >= MIN_HASHED_BYTES else None,
        lambda: decode(data, kind, encoding),
        lambda stand_in: decode(encode({**fields, "scene": stand_in}, encoding), kind, encoding),
        len(data),
    )


def read_request(request: bytes | str | dict[str, Any] | requests.Request) -> requests.Request:
    """Read and check a request in any form: JSON, plain data or a message; raises as `decode_request`.

    A large scene with the content of an earlier one is reused: arrays in it are compared by their bytes.
    """
    made: requests.Request
    if type(request) is bytes:
        made = read_payload(request, None, Encoding.JSON)
        return made
    if not isinstance(request, dict | msgspec.Struct):
        return decode_request(request)
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
        return decode_request({name: _to_plain(value) for name, value in request.items()})
    return decode_request(replace_arrays(request))


def _to_plain(value: Any) -> Any:
    some = value if isinstance(value, list | tuple) else (value,)
    return replace_arrays(value) if any(isinstance(one, msgspec.Struct) for one in some) else value


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
