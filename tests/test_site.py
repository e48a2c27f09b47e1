"""The documentation's site: every page is in it, every link within it leads somewhere."""

import importlib
import json
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urldefrag, urlparse

import pytest
from lxml import html

HOUSE = Path(__file__).resolve().parent.parent


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
