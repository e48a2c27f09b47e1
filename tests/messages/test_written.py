"""What is long is written some at a time in the very bytes of one go, and no part of it is long."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from guidefield.messages.written import TOGETHER, written

LONG = 2 * TOGETHER + 7
ROWS = [[0.5 * k, 1.0, -2.0] for k in range(LONG)]
PLACES = [{"position": row} for row in ROWS]

DECLARED: dict[str, Any] = {
    "nothing": {},
    "a word": "word",
    "a short list": [[1, 2, 3]] * 15,
    "16": [1] * 16,
    "rows": ROWS,
    "2^16 and more": [[0, 1, 2]] * (2**16 + 3),
    "a mesh": {"name": "s", "obstacles": [{"type": "mesh", "vertices": ROWS, "triangles": [[0, 1, 2]] * LONG}]},
    "boxes": {"obstacles": [{"name": f"b{k}", "size": [1.0, 2.0, 3.0]} for k in range(LONG)], "name": "s"},
    "many meshes": {"obstacles": [{"name": "m", "vertices": ROWS}] * LONG, "guide_planes": []},
    "one that moves": {"obstacles": [{"trajectory": {"times": [0.5] * LONG, "placements": PLACES}}]},
    "lists": [ROWS, [[0, 1, 2]] * LONG, 3],
}


@pytest.mark.parametrize("name", DECLARED)
def test_the_bytes_are_those_of_one_go_and_no_part_is_long(name: str) -> None:
    encoder = msgspec.msgpack.Encoder()
    whole, parts = encoder.encode(DECLARED[name]), [*written(DECLARED[name], encoder.encode)]
    assert b"".join(parts) == whole
    assert max(map(len, parts)) <= 60 * TOGETHER
