"""The list of keys says what the rules of the keys say."""

from __future__ import annotations

import pytest

from guidefield.messages import keys, stream_requests
from guidefield.messages.codec import Encoding
from guidefield.messages.schemas import make_schemas
from guidefield.messages.served import KEYS, SERVED, KeyInfo

QUERIED = [key for key in KEYS if key.how == "query"]


def _query(key: KeyInfo, parameters: dict[str, str] | None = None, payload: bytes = b"") -> keys.Query:
    chunks = tuple(chunk.strip("<>") for chunk in key.key.split("/"))
    return keys.Query(chunks, parameters or {}, payload, Encoding.JSON)


def _check(query: keys.Query) -> None:
    (stream_requests.check if stream_requests.is_stream(query) else keys.check)(query)


def test_every_message_has_its_schema() -> None:
    messages = make_schemas()
    known = {*messages["messages"], *messages["$defs"]}
    assert {name for key in KEYS for name in (*key.takes, *key.gives)} <= known


@pytest.mark.parametrize("key", QUERIED, ids=SERVED)
def test_a_key_is_served_with_its_parameters_and_no_others(key: KeyInfo) -> None:
    values = {"since": "1", "status": "SUCCESS"}
    for parameter in key.parameters:
        _check(_query(key, {parameter: values.get(parameter, "")}))
    _check(_query(key))
    if not (keys.is_file(_query(key)) or keys.is_cancel(_query(key))):
        with pytest.raises(keys.MalformedRequest, match="unknown parameter 'other'"):
            _check(_query(key, {"other": ""}))


@pytest.mark.parametrize("key", QUERIED, ids=SERVED)
def test_a_key_takes_a_payload_if_it_has_messages_for_it(key: KeyInfo) -> None:
    if key.takes:
        _check(_query(key, payload=b"{}"))
    else:
        with pytest.raises(keys.MalformedRequest, match="takes no payload"):
            _check(_query(key, payload=b"{}"))


def test_every_rule_is_told() -> None:
    own = {key.key for key in QUERIED if stream_requests.is_stream(_query(key))}
    assert own == {"streams", *(f"streams/<id>{what}" for what in ("", "/goal", "/judge", "/stop", "/recording"))}
    told = {(key.key.split("/")[0], key.key.count("/") + 1) for key in QUERIED}
    assert set(keys._RULES) <= told
