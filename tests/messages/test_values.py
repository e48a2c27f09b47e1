"""Numbers that no physical quantity has are refused where they come in."""

import struct
from array import array

import pytest

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.requests import TaggedRequest
from guidefield.messages.scene import PointCloud
from guidefield.messages.values import LARGEST, Float32Array

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
            with pytest.raises(MalformedRequest, match=r"`vertices\[2\]\[1\]` must be within"):
                codec.decode(data, TaggedRequest, Encoding.MSGPACK)
        else:
            codec.decode(data, TaggedRequest, Encoding.MSGPACK)


@pytest.mark.parametrize(
    ("packed", "told"),
    [
        (struct.pack("<6I", 0, 1, 2, 1, 0, 2), None),
        (struct.pack("<6I", 0, 1, 2, 1, 3, 2), r"triangles\[1\]` names vertex 3, but there are 3"),
        (struct.pack("<3I", 0, 1, 0xFFFFFFFF), "names vertex 4294967295"),
        (struct.pack("<3I", 0, 0x7FFFFFFF, 1), "names vertex 2147483647"),
        (struct.pack("<3I", 0x80000000, 0, 1), "names vertex 2147483648"),
        (struct.pack("<4I", 0, 1, 2, 0), "whole triples"),
        (b"", "1 to 1000000 triangles, got 0"),
    ],
)
def test_packed_triangles_are_checked(packed: bytes, told: str | None) -> None:
    vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    mesh = {**TRIANGLE, "vertices": vertices, "triangles": {"uint32": packed}}
    data = codec._ENCODERS[Encoding.MSGPACK].encode(_potential(mesh))
    if told is None:
        codec.decode(data, TaggedRequest, Encoding.MSGPACK)
    else:
        with pytest.raises(MalformedRequest, match=told):
            codec.decode(data, TaggedRequest, Encoding.MSGPACK)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 2 * LARGEST, -2 * LARGEST])
def test_one_point_of_many_that_is_no_place_is_seen(value: float) -> None:
    for near in (LARGEST, -0.9 * LARGEST, 1e-40, -0.0):
        PointCloud(name="c", points=Float32Array(array("f", [0.0] * 30 + [near, 1.0, 2.0]).tobytes()), radius=0.1)
        PointCloud(name="c", points=[(0.0, 0.0, 0.0)] * 10 + [(1.0, near, near)], radius=0.1)
    with pytest.raises(ValueError, match=r"points\[10\]\[0\]"):
        PointCloud(name="c", points=Float32Array(array("f", [0.0] * 30 + [value, 1.0, 2.0]).tobytes()), radius=0.1)
    with pytest.raises(ValueError, match=r"points\[10\]\[1\]"):
        PointCloud(name="c", points=[(0.0, 0.0, 0.0)] * 10 + [(1.0, value, 0.0)], radius=0.1)
