"""The page about the wire has the tables that the code makes, and `info` has the same in JSON."""

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

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
PAGE = (HOUSE / "service" / "docs" / "wire.md").read_text()
LIMITS = list_limits(limits_of(DEFAULT_QUEUE), DEFAULT_MEMORY, DEFAULT_RETENTION, DEFAULT_GRACE, DEFAULT_STREAMS)


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(HOUSE / "tools"))
    from pages import wire

    return wire


def test_the_tables_are_those_of_the_code(wire: ModuleType) -> None:
    assert set(re.findall(r"made from the code: ([a-z]+)", PAGE)) == set(wire.PARTS)
    assert wire.filled(PAGE) == PAGE, "`tools/wire_page` makes them again"


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
