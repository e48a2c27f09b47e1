"""Rerun chunks from archetypes: the small vocabulary in which the rest of this room writes."""

from __future__ import annotations

import colorsys
import functools
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

PATH_TIME = "path_time"  # timeline of the motion itself [s]
STEP = "step"  # timeline of the planner's accepted steps, counted
PLOTS = "/plots/"  # below it are the curves
GHOST_ENTITY = "/ghosts"  # entity of the robot along its way, translucent
PICTURE, PICTURE_AT_START = "/field/picture", "/field/picture_at_start"
"""Entities of the picture of the field: where nothing moves, and where it is that of the obstacles before they do."""


def entity(*parts: str) -> str:
    """Entity path of named parts, whatever characters the names have."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


WORLD = "tf#/"  # name of the world's coordinate frame: the one that Rerun gives to the root of all entities


def link_frame(link: str) -> str:
    """Name of a link's coordinate frame."""
    return f"link {link}"


def joint_frame(joint: str) -> str:
    """Name of the coordinate frame that a joint moves."""
    return f"joint {joint}"


def make_columns(
    archetype: Any, lengths: Sequence[int] | np.ndarray | None = None, **components: Any
) -> list[rr.ComponentColumn]:
    """Make columns of an archetype, sooner than its own `columns()`; rows have `lengths` (n,), by default 1."""
    columns = []
    for name, values in components.items():
        descriptor, batch = _component(archetype, name)
        column = batch(values)
        ends = np.arange(1, 1 + len(column)) if lengths is None else np.cumsum(lengths)
        columns.append(rr.ComponentColumn(descriptor, column, offsets=np.append(0, ends).astype(np.int32)))
    return columns


@functools.cache
def _component(archetype: Any, name: str) -> tuple[rr.ComponentDescriptor, type[Any]]:
    """The descriptor of a component, and the batch that makes Arrow's array of its values."""
    batch = getattr(archetype.__attrs_attrs__, name).converter.__self__
    short, full = archetype.archetype_short_name(), archetype.archetype()
    return rr.ComponentDescriptor(f"{short}:{name}", archetype=full, component_type=batch._COMPONENT_TYPE), batch


def still(path: str, *archetypes: Any) -> Chunk:
    """A chunk of an entity that holds at all times, from Rerun's archetypes."""
    return Chunk.from_columns(path, [], _single_row(archetypes))


def from_time(path: str, time: float, *archetypes: Any) -> Chunk:
    """A chunk of an entity that holds from a time of `PATH_TIME` on [s]."""
    return Chunk.from_columns(path, [path_times(np.array([time]))], _single_row(archetypes))


def timed(path: str, times: Iterable[rr.TimeColumn], columns: Iterable[rr.ComponentColumn]) -> Chunk:
    """A chunk of an entity with one row for each of n times."""
    return Chunk.from_columns(path, times, columns)


Color = tuple[int, int, int, int]  # RGBA


def rgba(hue: float, lightness: float, saturation: float, alpha: int = 255) -> Color:
    """The colour of a hue, lightness and saturation from 0 to 1."""
    red, green, blue = (round(255 * part) for part in colorsys.hls_to_rgb(hue, lightness, saturation))
    return red, green, blue, alpha


def rgba32(color: Sequence[int]) -> np.uint32:
    """A colour (RGBA) as Rerun packs it: of many that are alike, arrays of these are made sooner than of tuples."""
    red, green, blue, alpha = color
    return np.uint32(red << 24 | green << 16 | blue << 8 | alpha)


def path_times(times: np.ndarray) -> rr.TimeColumn:
    """The column of `PATH_TIME` for times (n,) [s]."""
    return rr.TimeColumn(PATH_TIME, duration=times)


def shown(chunks: Iterable[Chunk]) -> frozenset[str]:
    """The entities that have something to show: curves of a single point have not."""
    points = Counter[str]()
    for chunk in chunks:
        points[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    return frozenset(path for path, rows in points.items() if rows > 1 or not path.startswith(PLOTS))


def _single_row(archetypes: Iterable[Any]) -> list[rr.ComponentColumn]:
    batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
    ends = [np.array([0, len(batch.as_arrow_array())], np.int32) for batch in batches]
    return [
        rr.ComponentColumn(one.component_descriptor(), one, offsets=offsets)
        for one, offsets in zip(batches, ends, strict=True)
    ]
