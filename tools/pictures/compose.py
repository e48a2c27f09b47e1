"""Pictures put together: sheets with headings, and animations, as WebP."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

INK = (60, 66, 76)
GAP = 10
HEADING = 30
QUALITY = 82
NEARLY_WHITE = 245


def picture(png: bytes) -> Image.Image:
    """A screenshot, without the frame that a viewer draws around a view."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    return image.crop((2, 2, image.width - 2, image.height - 2))


def is_blank(image: Image.Image) -> bool:
    """Return whether there is hardly anything to see but the ground."""
    pixels = np.asarray(image, int)
    return bool((np.abs(pixels - pixels[0, 0]).max(axis=2) > 8).mean() < 0.01)


def sheet(rows: Sequence[Sequence[Image.Image]], columns: Sequence[str], width: int) -> Image.Image:
    """Pictures of one size in rows, a heading above each column, `width` pixels wide altogether."""
    cell_width = (width - GAP * (len(columns) - 1)) // len(columns)
    shown = [[scaled(image, cell_width) for image in trimmed(images)] for images in rows]
    whole = Image.new("RGB", (width, HEADING + sum(images[0].height + GAP for images in shown)), (255, 255, 255))
    pen, top = ImageDraw.Draw(whole), HEADING
    for column, heading in enumerate(columns):
        middle = column * (cell_width + GAP) + cell_width / 2
        pen.text((middle, HEADING / 2), heading, INK, ImageFont.load_default(18), anchor="mm")
    for images in shown:
        for column, image in enumerate(images):
            whole.paste(image, (column * (cell_width + GAP), top))
        top += images[0].height + GAP
    return whole


def trimmed(images: Sequence[Image.Image]) -> list[Image.Image]:
    """Pictures, made as large as the first, without what is blank above and below in all of them."""
    images = [image.resize(images[0].size) for image in images]
    filled = np.any([(np.asarray(image, int) < NEARLY_WHITE).any(axis=(1, 2)) for image in images], axis=0)
    at = np.flatnonzero(filled)
    top, bottom = max(0, at[0] - GAP), min(len(filled), at[-1] + GAP)
    return [image.crop((0, top, image.width, bottom)) for image in images]


def save(image: Image.Image, path: Path) -> None:
    """Write a picture as WebP."""
    image.save(path, quality=QUALITY, method=6)


def save_animation(frames: Sequence[Image.Image], path: Path, seconds: float, hold: float = 0.8) -> None:
    """Write an animated WebP that lasts so long [s], holds its last picture and begins again."""
    step = round(1e3 * seconds / len(frames))
    durations = [step] * (len(frames) - 1) + [round(1e3 * hold)]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=70, method=4)


def scaled(image: Image.Image, width: int) -> Image.Image:
    """A picture at another width [pixels]."""
    return image.resize((width, round(width * image.height / image.width)), Image.Resampling.LANCZOS)
