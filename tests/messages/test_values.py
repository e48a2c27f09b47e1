"""Numbers that no physical quantity has are refused where they come in."""

from __future__ import annotations

import struct

import pytest

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.requests import TaggedRequest
from guidefield.messages.values import LARGEST

TRIANGLE = {"type": "mesh", "name": "m", "triangles": [[0, 1, 2]]}


def _potential(obstacle: dict[str, object]) -> dict[str, object]:
    return {"type": "potential", "points": [[0, 0, 0]], "scene": {"name": "s", "obstacles": [obstacle]}}


@pytest.mark.parametrize(
    ("radius", "says"), [(2 * LARGEST, "within 1e"), (1e308, "within 1e"), (float("inf"), "finite")]
)
def test_a_number_that_is_too_large_is_refused_by_name(radius: float, says: str) -> None:
    request = _potential({"type": "sphere", "name": "s", "radius": radius})
    with pytest.raises(MalformedRequest, match=f"`radius.*{says}"):
        codec.decode_request(request)
    codec.decode_request(_potential({"type": "sphere", "name": "s", "radius": LARGEST}))


def test_packed_vertices_are_bounded_too() -> None:
    for largest, refused in ((1e30, True), (1.0, False)):
        packed = {"float32": struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, largest, 0)}
        data = codec._ENCODERS[Encoding.MSGPACK].encode(_potential({**TRIANGLE, "vertices": packed}))
        if refused:
            with pytest.raises(MalformedRequest, match="finite"):
                codec.decode(data, TaggedRequest, Encoding.MSGPACK)
        else:
            codec.decode(data, TaggedRequest, Encoding.MSGPACK)
