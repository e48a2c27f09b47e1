"""Decode requests and encode replies, as JSON or MessagePack; decoders are strict and built once at import."""

from __future__ import annotations

import enum
import functools
from typing import Any

import msgspec

from guidefield.errors import MalformedRequest, RequestTooLarge
from guidefield.messages import faults, requests
from guidefield.messages.scene import Scene

MAX_REQUEST_BYTES = 64 * 2**20
"""Largest payload that is decoded; a larger one is refused as too large."""

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


def decode_request(request: bytes | dict[str, Any] | requests.Request) -> requests.Request:
    """Decode a request in any form: JSON bytes, plain data, or a Struct; one without a `type` is a plan request."""
    if isinstance(request, msgspec.Struct):
        return request
    if isinstance(request, dict):
        converted: requests.Request = convert(
            request, requests.TaggedRequest if "type" in request else requests.PlanRequest
        )
        return converted
    if not isinstance(request, bytes | bytearray | memoryview | str):
        raise MalformedRequest(f"a request is JSON, a dict or a message, not {type(request).__name__}", path="$")
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
    return MalformedRequest(f"{message} (at {path})", path=path, **({"available": choices} if choices else {}))
