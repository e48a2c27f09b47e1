"""Queries become the requests of their keys, of streams and of users too; the list of keys says what its rules say."""

import contextlib
import pickle
from collections.abc import Mapping

import msgspec
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages import keys, requests, stream_requests
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, base_key, check_user, split_user
from guidefield.messages.keys import KEYS, SERVED, KeyInfo, Query
from guidefield.messages.scene import Scene
from guidefield.messages.schemas import make_schemas
from guidefield.messages.stream_requests import (
    AimStream,
    EndStream,
    HaltStream,
    JudgeStream,
    ListStreams,
    OpenStream,
    ReadStream,
    RecordStream,
    decode_stream_query,
    is_stream,
)

PLAN = b"""{"robot": "panda", "scene": "bookshelf", "goal": {"type": "guide_plane"},
           "allowed_planning_time": 7, "run_id": "r"}"""


def _query(key: str, payload: bytes = b"", parameters: Mapping[str, str] | None = None) -> keys.Query:
    return keys.Query(tuple(key.split("/")), parameters or {}, payload, Encoding.JSON)


@pytest.mark.parametrize(
    ("query", "request_"),
    [
        (_query("robots"), requests.ReadRobots()),
        (_query("robots/panda"), requests.ReadRobot("panda")),
        (_query("scenes"), requests.ReadScenes()),
        (_query("scenes/shelf"), requests.ReadScene("shelf")),
        (_query("scenes/shelf", b'{"name": "shelf"}'), requests.StoreScene("shelf", Scene("shelf"))),
        (_query("scenes/shelf", parameters={"delete": ""}), requests.DeleteScene("shelf")),
        (_query("runs"), requests.ReadRuns()),
        (
            _query("runs", parameters={"status": "SUCCESS", "robot": "panda", "since": "1e9"}),
            requests.ReadRuns("SUCCESS", "panda", 1e9),
        ),
        (
            _query("runs", parameters={"text": "null", "limit": "7", "after": "12"}),
            requests.ReadRuns(text="null", limit=7, after="12"),
        ),
        (_query("runs/r1"), requests.ReadRun("r1")),
        (_query("runs/r1", parameters={"delete": ""}), requests.DeleteRun("r1")),
        (_query("info"), requests.ReadInfo()),
        (
            _query("kinematics", b'{"type": "potential", "scene": "s", "points": [[0, 0, 0]]}'),
            requests.Potential("s", points=[(0.0, 0.0, 0.0)]),
        ),
    ],
)
def test_each_key_asks_for_its_request(query: keys.Query, request_: requests.Request) -> None:
    keys.check(query)
    assert keys.decode_query(query) == request_


def test_a_plan_is_read_and_its_head_is_the_same_run() -> None:
    request = keys.decode_query(_query("plan", PLAN))
    head = keys.decode_run_head(_query("plan", PLAN))
    assert isinstance(request, requests.PlanRequest)
    assert (head.run_id, head.allowed_planning_time, head.seed) == (request.run_id, request.allowed_planning_time, 0)
    assert keys.decode_run_head(_query("kinematics", PLAN)) is None


def test_a_judgement_is_read_and_its_head_is_the_same_run() -> None:
    asked = b'{"robot": "panda", "scene": "table", "path": [[0]], "allowed_time": 7, "run_id": "r"}'
    request, head = keys.decode_query(_query("certify", asked)), keys.decode_run_head(_query("certify", asked))
    assert isinstance(request, requests.CertifyRequest)
    assert head == keys.CertifyHead("r", 7.0)
    assert (request.run_id, request.allowed_time) == ("r", 7.0)
    tagged = keys.decode_query(_query("certify", b'{"type": "certify", ' + asked[1:]))
    assert tagged == request


@pytest.mark.parametrize(("given_", "allowed"), [(7.0, 7.0), (-1.0, 5.0), (float("nan"), 5.0), (1e300, 3600.0)])
def test_an_impossible_planning_time_waits_long_enough_to_be_refused(given_: float, allowed: float) -> None:
    payload = msgspec.msgpack.encode({"allowed_planning_time": given_})
    head = keys.decode_run_head(keys.Query(("plan",), {}, payload, Encoding.MSGPACK))
    assert head.allowed == allowed


@pytest.mark.parametrize(
    ("query", "says"),
    [
        (_query("nothing"), "nothing is served at 'nothing'; served are plan"),
        (_query(""), "nothing is served"),
        (_query("plan/more"), "nothing is served"),
        (_query("runs/r1/progress"), "nothing is served"),
        (_query("robots", parameters={"delete": ""}), "unknown parameter 'delete'"),
        (_query("runs", parameters={"sinse": "1"}), "valid: after, limit, robot, since, status, text"),
        (_query("runs", parameters={"since": "yesterday"}), "seconds since 1970"),
        (_query("runs", parameters={"since": "nan"}), "seconds since 1970, got 'nan'"),
        (_query("runs", parameters={"since": "-inf"}), "seconds since 1970"),
        (_query("runs", parameters={"status": "success"}), "`status` must be one of SUCCESS, PLANNING_FAILED"),
        (_query("runs", parameters={"limit": "0"}), "`limit` must be `int` >= 1"),
        (_query("runs", parameters={"limit": "1001"}), "`limit` must be `int` <= 1000"),
        (_query("runs", parameters={"limit": "many"}), "`limit` must be `int`"),
        (_query("runs", parameters={"after": "-1"}), "`after` must be the `next` of a list of runs, got '-1'"),
        (_query("runs", parameters={"after": 20 * "9"}), "`after` must be the `next` of a list of runs"),
        (_query("runs", parameters={"text": ""}), "`text` must be `str` of length >= 1"),
        (_query("robots", b"{}"), "takes no payload"),
        (_query("scenes/shelf", b"{}", {"delete": ""}), "takes no payload"),
        (_query("scenes/shelf", b'{"name": "other"}'), "named 'other', but it is sent to be stored as 'shelf'"),
        (_query("kinematics", b'{"type": "info"}'), "Invalid value 'info'"),
        (_query("plan", b'{"type": "info"}'), "unknown field `type`"),
        (_query("plan"), "it is empty"),
    ],
)
def test_what_does_not_fit_is_said(query: keys.Query, says: str) -> None:
    with pytest.raises(MalformedRequest) as malformed:
        keys.decode_query(query)
    assert says in malformed.value.message


@given(
    st.lists(st.text(max_size=8), max_size=4), st.dictionaries(st.text(max_size=8), st.text(max_size=8)), st.binary()
)
@settings(max_examples=90)
def test_any_query_is_a_request_or_says_why_not(key: list[str], parameters: dict[str, str], payload: bytes) -> None:
    for encoding in Encoding:
        query = keys.Query(tuple(key), parameters, payload, encoding)
        for read in (keys.check, keys.decode_query, keys.decode_run_head):
            with contextlib.suppress(GuidefieldError):
                read(query)


def test_a_large_payload_travels_beside_the_pickled_query() -> None:
    query, beside = _query("plan", b"7" * keys.MIN_BESIDE), list[pickle.PickleBuffer]()
    pickled = pickle.dumps(query, 5, buffer_callback=beside.append)
    assert len(pickled) < 1000
    assert [one.raw().tobytes() for one in beside] == [query.payload]
    made = pickle.loads(pickled, buffers=[bytearray(query.payload)])
    assert made == query
    assert type(made.payload) is bytes, "a decoder tells bytes from all else"


@pytest.mark.parametrize("protocol", [4, 5])
@pytest.mark.parametrize("size", [0, keys.MIN_BESIDE])
def test_a_query_comes_out_of_any_pickle_as_it_was(protocol: int, size: int) -> None:
    query = _query("plan", b"7" * size, {"a": "b"})
    assert pickle.loads(pickle.dumps(query, protocol)) == query


QUERIED = [key for key in KEYS if key.how == "query"]


def _query_of(key: KeyInfo, parameters: dict[str, str] | None = None, payload: bytes = b"") -> keys.Query:
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
        _check(_query_of(key, {parameter: values.get(parameter, "")}))
    _check(_query_of(key))
    if not (keys.is_file(_query_of(key)) or keys.is_cancel(_query_of(key))):
        with pytest.raises(keys.MalformedRequest, match="unknown parameter 'other'"):
            _check(_query_of(key, {"other": ""}))


@pytest.mark.parametrize("key", QUERIED, ids=SERVED)
def test_a_key_takes_a_payload_if_it_has_messages_for_it(key: KeyInfo) -> None:
    if key.takes:
        _check(_query_of(key, payload=b"{}"))
    else:
        with pytest.raises(keys.MalformedRequest, match="takes no payload"):
            _check(_query_of(key, payload=b"{}"))


def test_every_rule_is_told() -> None:
    own = {key.key for key in QUERIED if stream_requests.is_stream(_query_of(key))}
    assert own == {"streams", *(f"streams/<id>{what}" for what in ("", "/goal", "/judge", "/stop", "/recording"))}
    told = {(key.key.split("/")[0], key.key.count("/") + 1) for key in QUERIED}
    assert set(keys._RULES) <= told


OPEN = b'{"robot": "ur5", "scene": "table"}'


def query(key: str, payload: bytes = b"", **parameters: str) -> Query:
    return Query(tuple(key.split("/")), parameters, payload, Encoding.JSON)


def test_what_is_asked_for() -> None:
    assert decode_stream_query(query("streams")) == ListStreams()
    opened = decode_stream_query(query("streams", OPEN))
    assert isinstance(opened, OpenStream)
    assert opened.request.robot == "ur5"
    assert decode_stream_query(query("streams/a")) == ReadStream("a")
    assert decode_stream_query(query("streams/a", delete="")) == EndStream("a")
    assert decode_stream_query(query("streams/a/goal", b"{}")) == AimStream("a")
    assert decode_stream_query(query("streams/a/judge", b"{}")) == JudgeStream("a")
    assert decode_stream_query(query("streams/a/stop")) == HaltStream("a")
    assert decode_stream_query(query("streams/a/recording")) == RecordStream("a")
    assert is_stream(query("streams/a"))
    assert not is_stream(query("scenes/streams"))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (query("streams/a/pieces"), "nothing is served at 'streams/a/pieces'; served are"),
        (query("streams/a/b/c"), "nothing is served"),
        (query("streams", OPEN, delete=""), "unknown parameter 'delete' at 'streams'; valid: none"),
        (query("streams/a", robot="x"), "unknown parameter 'robot' at 'streams/a'; valid: delete"),
        (query("streams/a", b"{}"), "takes no payload"),
        (query("streams/a/stop", b"{}"), "takes no payload"),
        (query("streams/a/recording", b"{}"), "takes no payload"),
        (query("streams/a/recording", robot="x"), "unknown parameter 'robot' at 'streams/a/recording'; valid: none"),
        (query("streams/a/goal"), "StreamAim"),
        (query("streams/a/judge"), "StreamJudge"),
        (query("streams", b'{"robot": "ur5"}'), "scene"),
        (query("streams", OPEN[:-1] + b', "stream_id": "a/b"}'), "stream_id"),
        (query("streams", OPEN[:-1] + b', "latency": NaN}'), "NaN|malformed|invalid"),
    ],
)
def test_what_does_not_fit(asked: Query, words: str) -> None:
    with pytest.raises(MalformedRequest, match=words):
        decode_stream_query(asked)


USERS = st.from_regex(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}", fullmatch=True).filter(lambda user: user != PLAIN)
CHUNKS = st.lists(st.from_regex(r"[a-z0-9]{1,8}", fullmatch=True), min_size=1, max_size=3).filter(
    lambda chunks: chunks[0] != "as"
)


@given(USERS, CHUNKS)
def test_a_key_below_a_users_is_that_users_and_every_other_one_is_plain(user: str, chunks: list[str]) -> None:
    for asking in (user, PLAIN):
        key = f"{base_key('cell', asking)}/{'/'.join(chunks)}"
        assert split_user(key.split("/")[2:]) == (asking, tuple(chunks))


@pytest.mark.parametrize("user", ["", "plain", ".hidden", "a/b", "a:b", "*", "a b", "x" * 65, "ä"])
def test_nobody_can_be_called_what_is_no_chunk_no_folder_or_another_identity(user: str) -> None:
    with pytest.raises(MalformedRequest, match="must be 1 to 64 of the characters"):
        check_user(user)
    with pytest.raises(MalformedRequest):
        split_user(["as", user, "plan"])
