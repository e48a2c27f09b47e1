"""Clouds as files: PCD in its three forms, with a packer of LZF, XYZ, PLY and npz."""

import io
import struct
from collections.abc import Callable

import numpy as np


def lzf(body: bytes) -> bytes:
    """Pack bytes: the last place of each three bytes is referred to, as far as it is equal, overlaps too."""
    packed, run, places, at = bytearray(), bytearray(), dict[bytes, int](), 0
    while at < len(body):
        start, places[body[at : at + 3]] = places.get(body[at : at + 3], -1), at
        length = 0
        while start >= 0 and at - start <= 8192 and length < 264 and body[at + length : at + length + 1]:
            if body[start + length] != body[at + length]:
                break
            length += 1
        if length < 3:
            run.append(body[at])
            at += 1
        if run and (length >= 3 or len(run) == 32 or at == len(body)):
            packed += bytes([len(run) - 1]) + run
            run.clear()
        if length >= 3:
            back, code = at - start - 1, length - 2
            head = bytes([min(code, 7) << 5 | back >> 8])
            packed += head + (bytes([code - 7]) if code >= 7 else b"") + bytes([back & 255])
            at += length
    return bytes(packed)


def pcd(points: np.ndarray, form: str) -> bytes:
    """PCD with a normal before the position and a colour behind it."""
    row = np.zeros(len(points), [("normal", "<f4", 3), ("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("rgb", "<u4")])
    row["x"], row["y"], row["z"] = points.T
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS normal x y z rgb\nSIZE 4 8 8 8 4\nTYPE F F F F U\nCOUNT 3 1 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {len(points)}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        return head + "".join(f"0 0 0 {x!r} {y!r} {z!r} 255\n" for x, y, z in points.tolist()).encode()
    if form == "binary":
        return head + row.tobytes()
    body = b"".join(np.ascontiguousarray(row[name]).tobytes() for name in row.dtype.names or ())
    packed = lzf(body)
    return head + struct.pack("<II", len(packed), len(body)) + packed


def ply(points: np.ndarray) -> bytes:
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    return head.encode() + points.astype("<f8").tobytes()


def xyz(points: np.ndarray) -> bytes:
    return ("# x, y, z, intensity\n" + "".join(f"{x!r},{y!r};{z!r} 7\n" for x, y, z in points.tolist())).encode()


def npz(points: np.ndarray, name: str = "points") -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{name: points})
    return file.getvalue()


WRITERS: dict[str, tuple[str, Callable[[np.ndarray], bytes]]] = {
    "pcd ascii": (".pcd", lambda points: pcd(points, "ascii")),
    "pcd binary": (".pcd", lambda points: pcd(points, "binary")),
    "pcd compressed": (".PCD", lambda points: pcd(points, "binary_compressed")),
    "ply": (".ply", ply),
    "xyz": (".xyz", xyz),
    "npz": (".npz", npz),
    "npz of another name": (".npz", lambda points: npz(np.column_stack([points, points]), "scan")),
}
"""Suffix and writer by what a file is like."""
