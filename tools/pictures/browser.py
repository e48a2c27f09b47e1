"""`guidefield show --web` in a real browser without a display, and a picture of what it shows."""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from pictures import compose

WINDOW = {"width": 1400, "height": 800}
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox")
PATIENCE = 180.0
"""How long the page may take to show the recording [s]; in software each of its pictures takes a second."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def missing() -> str | None:
    """Why there can be no picture here, if so."""
    if not any(map(shutil.which, BROWSERS)):
        return "there is no Chromium (Debian: apt install chromium)"
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "there is no playwright (pip install 'guidefield[gallery]')"
    return None


def web_picture(recording: Path, picture: Path) -> Iterator[str]:
    """Serve a recording, open it in Chromium, keep a picture of the page; what is wrong with it."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, BROWSERS)))
    with _shown(recording) as url, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path, args=list(SOFTWARE))
        page = browser.new_page(viewport=WINDOW)
        page.goto(url)
        deadline = time.monotonic() + PATIENCE
        while True:
            time.sleep(5.0)
            image = compose.picture(page.screenshot(timeout=1e3 * PATIENCE))
            if shows_a_recording(image):
                break
            if time.monotonic() > deadline:
                yield f"the page shows no recording after {PATIENCE:.0f} s"
                break
        browser.close()
    compose.save(compose.scaled(image, 1200), picture)


def shows_a_recording(image: Image.Image) -> bool:
    """Whether there are bodies, and at the left edge too: without our layout there is a grey panel of text."""
    pixels = np.asarray(image, int)
    height, width, _ = pixels.shape
    edge = pixels[height // 6 : -height // 6, : width // 8].reshape(-1, 3)
    colours, counts = np.unique(edge, axis=0, return_counts=True)
    plain = counts[np.ptp(colours, axis=1) < 20].max(initial=0) / len(edge)
    return bool(plain < 0.7 and len(np.unique(pixels.reshape(-1, 3), axis=0)) > 2000)


@contextlib.contextmanager
def _shown(recording: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "guidefield", "show", "--web", str(recording)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            said = process.stdout.readline()
            yield re.search(r"http://\S+", said).group()
        finally:
            process.terminate()
