"""The site has every page and every link leads somewhere; tables of the wire are those that the code makes."""

import importlib
import json
import re
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urldefrag, urlparse

import pytest
from lxml import html

from guidefield.endpoint.endpoint import HEAVY_KEYS
from guidefield.endpoint.rules import DELIVERY, list_limits
from guidefield.endpoint.service import DEFAULT_GRACE, DEFAULT_QUEUE, limits_of
from guidefield.errors import ERRORS, Status
from guidefield.handlers.info import Figures, Rules, info
from guidefield.messages import codec
from guidefield.messages.keys import KEYS
from guidefield.messages.schemas import describe_message, make_schemas, write_schemas
from guidefield.messages.service import CODES, MEANINGS
from guidefield.messages.streams import DEFAULT_STREAMS
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.stores.runs import DEFAULT_RETENTION

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


PAGE = (HOUSE / "service" / "docs" / "wire.md").read_text()
LIMITS = list_limits(limits_of(DEFAULT_QUEUE), DEFAULT_MEMORY, DEFAULT_RETENTION, DEFAULT_GRACE, DEFAULT_STREAMS)


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(HOUSE / "tools"))
    from pages import wire

    return wire


def test_the_tables_are_those_of_the_code(wire: ModuleType) -> None:
    assert set(re.findall(r"made from the code: ([a-z]+)", PAGE)) == set(wire.PARTS)
    assert wire.fill(PAGE) == PAGE, "`tools/wire_page` makes them again"


def test_the_schemas_beside_the_page_are_those_of_the_code() -> None:
    kept = HOUSE / "service" / "docs" / "wire.schema.json"
    assert kept.read_text() == write_schemas(), "`tools/wire_page` makes them again"
    assert json.loads(kept.read_text())["$defs"] == json.loads(json.dumps(make_schemas()["$defs"]))


def test_every_message_that_a_key_takes_or_gives_is_named_on_the_page_and_described() -> None:
    named = {name for key in KEYS for name in (*key.takes, *key.gives)}
    told = set(re.findall(r"`(\w+)`", PAGE))
    assert named <= told
    for name in (told & set(make_schemas()["$defs"])) | {"ErrorReply"}:
        schema, text = make_schemas()["$defs"][name], describe_message(name)
        rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| (`[^`]*`|) \| (.*) \|$", text.replace("\\|", "/"), re.MULTILINE)
        assert {row for row, *_ in rows} == set(schema.get("properties", {})), name
        assert {row for row, default, _ in rows if not default} == set(schema.get("required", [])), name


def test_every_field_of_a_plan_request_says_what_it_means() -> None:
    properties = make_schemas()["$defs"]["PlanRequest"]["properties"]
    assert [name for name, one in properties.items() if not one.get("description")] == []


def test_every_code_has_its_meaning_and_says_how_it_travels() -> None:
    assert set(MEANINGS) == set(Status)
    assert [one.code for one in CODES] == [int(status) for status in Status]
    told = {one.name: one for one in CODES}
    assert {one.name for one in CODES if one.exception} == {status.name for status in ERRORS}
    assert {name for name, one in told.items() if one.travels == "either"} == {"TIMED_OUT", "PREEMPTED"}
    assert all((one.travels == "reply") == (one.exception is None) for one in CODES)


def test_a_key_waits_for_a_worker_as_it_says() -> None:
    always = {key.key.split("/")[0] for key in KEYS if key.worker == "always"}
    assert always == {*HEAVY_KEYS, "streams"}
    assert [key.key for key in KEYS if key.key.startswith("streams") and key.worker == "always"] == [
        "streams/<id>/recording"
    ]
    assert [key.key for key in KEYS if key.how == "query" and key.takes and key.worker == "never"] == []


def test_info_has_the_same() -> None:
    reply = info(Figures({}, 0.0), Rules(LIMITS, DELIVERY))
    plain = json.loads(codec.encode(reply))
    assert [key["key"] for key in plain["keys"]] == [key.key for key in KEYS]
    assert [code["name"] for code in plain["codes"]] == [status.name for status in Status]
    names = [limit["name"] for limit in plain["limits"]]
    assert names == re.findall(r"^\| `([a-z_]+)`: [\d.,]+ ", PAGE, re.MULTILINE)
    assert len(set(names)) == len(names)
    rules = [rule["name"] for rule in plain["delivery"]]
    assert rules == re.findall(r"^- \*\*([a-z ]+)\*\*: ", PAGE.partition("## Keys")[0], re.MULTILINE)
    assert {limit["name"]: limit["value"] for limit in plain["limits"]}["payload"] == plain["payload_limit"]
