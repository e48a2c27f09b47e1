"""A picture of the field in a plane through a scene: dark valleys between bright obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.kernels.field import field_at_points
from guidefield.kernels.field_tables import FieldTables

DECADES = 2.5
"""How many powers of ten a picture spans, from its darkest."""


@dataclass(frozen=True, eq=False)
class SlicePlane:
    """A rectangle in the world.

    Attributes:
        corner: Where the picture's first row and column meet, shape (3,) [m].
        across: From there along the first row to the last column, shape (3,) [m].
        down: From there along the first column to the last row, shape (3,) [m].
    """

    corner: np.ndarray
    across: np.ndarray
    down: np.ndarray

    def points(self, rows: int, columns: int) -> np.ndarray:
        """Centres of the pixels, shape (rows, columns, 3) [m]."""
        s, t = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        points: np.ndarray = self.corner + s[None, :, None] * self.across + t[:, None, None] * self.down
        return points


def horizontal(centre: tuple[float, float, float], size: float) -> SlicePlane:
    """A square seen from above: x to the right, y up."""
    corner = np.array([centre[0] - 0.5 * size, centre[1] + 0.5 * size, centre[2]])
    return SlicePlane(corner, np.array([size, 0.0, 0.0]), np.array([0.0, -size, 0.0]))


def potential_slice(tables: FieldTables, plane: SlicePlane, resolution: int) -> np.ndarray:
    """The logarithm of the potential in a plane.

    Args:
        tables: What is charged.
        plane: Where.
        resolution: Pixels along the longer side.

    Returns:
        log10 of the potential [1/m], shape (rows, columns); NaN inside of solids, -inf where nothing is charged.

    Raises:
        ValueError: if the resolution is not positive.
    """
    if resolution < 1:
        raise ValueError(f"`resolution` must be positive, got {resolution}")
    width, height = float(np.linalg.norm(plane.across)), float(np.linalg.norm(plane.down))
    columns, rows = (max(1, round(resolution * side / max(width, height))) for side in (width, height))
    field = field_at_points(tables, plane.points(rows, columns).reshape(-1, 3))
    with np.errstate(divide="ignore"):
        image = np.log10(field.potential)
    image[field.winding > 0.5] = np.nan
    return image.reshape(rows, columns)


def shaded(image: np.ndarray) -> np.ndarray:
    """Grey levels of a slice, shape (rows, columns), uint8: valleys dark, walls and what is inside of solids white."""
    finite = image[np.isfinite(image)]
    low = float(finite.min()) if finite.size else 0.0
    share = np.clip((image - low) / DECADES, 0.0, 1.0)
    levels: np.ndarray = np.where(np.isnan(image), 255.0, 255.0 * share).astype(np.uint8)
    return levels
