"""The documentation's site: every page is in it, every link within it leads somewhere, and a browser opens it."""

from __future__ import annotations

import functools
import http.server
import importlib
import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urldefrag, urlparse

import pytest
from lxml import html

HOUSE = Path(__file__).resolve().parent.parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 60_000
"""How long a page may take on a busy machine [ms]."""


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HOUSE / "tools"))
        return importlib.import_module("pages.site")


@pytest.fixture(scope="module")
def site(pages: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocstrings", reason="the site needs MkDocs: pip install -e '.[site]'")
    folder = tmp_path_factory.mktemp("site")
    pages.build_site(folder / "site", folder / "pages")  # strict: MkDocs refuses links that lead nowhere
    return folder / "site"


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing of each request."""


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    handler = functools.partial(Quiet, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def test_every_page_is_in_the_navigation_once(pages: ModuleType) -> None:
    listed = [name for names in pages.CHAPTERS.values() for name in names]
    assert sorted(listed) == sorted(set(pages.make_pages()) - {"index"})


def test_every_link_within_the_site_leads_somewhere(site: Path) -> None:
    documents = {path: html.fromstring(path.read_bytes()) for path in site.glob("*.html")}
    names = {path: {*tree.xpath("//@id"), *tree.xpath("//a/@name"), ""} for path, tree in documents.items()}
    lost = []
    for path, tree in documents.items():
        if path.name == "404.html":
            continue  # its links are from the root of a server
        for link in tree.xpath("//a/@href | //img/@src | //link/@href | //script/@src"):
            target, place = urldefrag(link)
            if urlparse(target).scheme or target.startswith("//"):
                continue
            file = (path.parent / unquote(target)).resolve() if target else path
            file = file / "index.html" if file.is_dir() else file
            if not file.exists() or (file in names and unquote(place) not in names[file]):
                lost.append((path.name, link))
    assert lost == []


def test_public_names_messages_and_words_are_found(site: Path, pages: ModuleType) -> None:
    index = json.loads((site / "search" / "search_index.json").read_text())["docs"]
    found = {entry["location"] for entry in index}
    assert {"messages.html#planrequest", "api.html#guidefield.engine.answer", "wire.html#codes"} <= found
    described = {place.partition("#")[2] for place in found if place.startswith("api.html#guidefield")}
    public = {f"guidefield.{room}.{name}" for room, names in pages.guidefield._ROOMS.items() for name in names}
    assert public <= described


def test_what_a_function_returns_is_told_in_one_row(site: Path) -> None:
    """A sentence that goes on in the next line is no second value."""
    page = html.fromstring((site / "api.html").read_bytes())
    returned = page.xpath("//p[span[normalize-space()='Returns:']]/following-sibling::*[1]//tbody")
    assert len(returned) > 4
    assert {len(body.xpath("tr")) for body in returned} == {1}
    kinds = {body.xpath("string(tr/td[1])").strip() for body in returned}
    assert {"Reply", "PlanReply", "CertifyReply", "str"} <= kinds
    assert [kind for kind in kinds if " " in kind] == []


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    driver = pytest.importorskip("playwright.sync_api", reason="there is no playwright (the extra `gallery`)")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip("there is no Chromium to open the site in (Debian: apt install chromium)")
    with driver.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


def _page(browser: Any, address: str, scheme: str) -> tuple[Any, list[str]]:
    """A page of the browser, and what goes wrong in it: errors, missing files, questions to other servers."""
    page, faults = browser.new_context(color_scheme=scheme).new_page(), list[str]()
    page.set_default_timeout(PATIENCE)
    page.on("pageerror", lambda error: faults.append(f"{page.url}: {error}"))
    page.on("response", lambda answer: answer.ok or answer.status < 400 or faults.append(f"no {answer.url}"))
    page.on("request", lambda request: request.url.startswith(address) or faults.append(f"asks {request.url}"))
    return page, faults


def test_a_browser_follows_every_link(browser: Any, address: str) -> None:
    page, faults = _page(browser, address, "light")
    names, asked, left = dict[str, set[str]](), set[tuple[str, str]](), [address + "index.html"]
    while left:
        url = left.pop()
        if url in names or not url.endswith(".html"):
            continue
        page.goto(url)
        names[url] = {"", *page.evaluate("[...document.querySelectorAll('[id]')].map(one => one.id)")}
        broken = "[...document.images].filter(one => one.complete && !one.naturalWidth).map(one => one.src)"
        assert page.evaluate(broken) == []
        for link in page.evaluate("[...document.querySelectorAll('a[href]')].map(one => one.href)"):
            target, place = urldefrag(link)
            if target.startswith(address):
                asked.add((target, unquote(place)))
                left.append(target)
    assert len(names) > 25
    assert [(url, place) for url, place in asked if url in names and place not in names[url]] == []
    assert faults == []
