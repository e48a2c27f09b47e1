"""Asking the freest of several instances, being refused, and waiting for an answer."""

import contextlib
import json
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, wait

import pytest
import zenoh
from hypothesis import given, strategies as st

from guidefield.cli.serving import LOOPBACK, free_port
from guidefield.client.exchange import MAX_REMEMBERED_RUNS, THREAD_NAME, Exchange, Loads, await_answer
from guidefield.client.questions import Question
from guidefield.errors import ServerBusy
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import make_error_reply
from tests.journeys.service import ANSWERED_WITHIN, await_that

INTERRUPTED_IN_ANOTHER_THREAD = """
import signal, sys, threading, time
from concurrent.futures import Future
from guidefield.client.exchange import await_answer

def take_it():
    time.sleep(0.2)  # until the main thread waits
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)

threading.Thread(target=take_it, daemon=True).start()
try:
    await_answer(Future())
except KeyboardInterrupt:
    sys.exit("interrupted")
"""


def test_an_answer_is_what_it_holds_or_raises_it() -> None:
    answer: Future[bytes] = Future()
    answer.set_result(b"answer")
    assert await_answer(answer) == b"answer"
    refused: Future[bytes] = Future()
    refused.set_exception(ServerBusy("later"))
    with pytest.raises(ServerBusy, match="later"):
        await_answer(refused)


def test_a_ctrl_c_that_another_thread_takes_interrupts_the_wait() -> None:
    command = [sys.executable, "-c", INTERRUPTED_IN_ANOTHER_THREAD]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (1, "interrupted\n")


@contextlib.contextmanager
def _asking(*instances: str) -> Iterator[Exchange]:
    """Instances of which the first refuses, being busy, and the others answer with their names."""
    with free_port() as port, contextlib.ExitStack() as opened:
        service = opened.enter_context(zenoh.open(_config("peer", "listen", port)))
        for name in instances:
            opened.enter_context(
                service.declare_queryable(f"guidefield/{name}/**", _busy if name == "busy" else _named)
            )
            opened.enter_context(service.liveliness().declare_token(f"guidefield/{name}/alive"))
        exchange = Exchange(zenoh.open(_config("client", "connect", port)), None)
        opened.callback(exchange.close)
        await_that(lambda: all(exchange.is_there(name) for name in instances))
        exchange.remember("own", "busy")
        yield exchange


def _config(mode: str, way: str, port: int) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{way}/endpoints", json.dumps([f"tcp/{LOOPBACK}:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


def _busy(query: zenoh.Query) -> None:
    with query:
        query.reply_err(codec.encode(make_error_reply(ServerBusy("later", retry_after=1.0)), Encoding.MSGPACK))


def _named(query: zenoh.Query) -> None:
    with query:
        query.reply(query.key_expr, str(query.key_expr).split("/")[1].encode())


def _answered(exchange: Exchange) -> tuple[Future[bytes], list[str]]:
    """The answer to a question that goes to the busy instance first, and the name of the thread that brought it."""
    brought: list[str] = []
    answer = exchange.ask(Question("plan", bytes, run_id="own", work=True, timeout=ANSWERED_WITHIN))
    answer.add_done_callback(lambda _: brought.append(threading.current_thread().name))
    wait([answer], ANSWERED_WITHIN)
    await_that(lambda: brought)
    return answer, brought


def test_a_refusal_by_the_only_instance_is_brought_at_once() -> None:
    """Without a thread of its own: to start one took longer than the refusal."""
    with _asking("busy") as exchange:
        answer, brought = _answered(exchange)
        with pytest.raises(ServerBusy, match="later"):
            answer.result()
        assert brought != [THREAD_NAME]


def test_where_one_instance_refuses_another_one_is_asked() -> None:
    with _asking("busy", "free") as exchange:
        answer, _ = _answered(exchange)
        assert answer.result() == b"free"


def test_questions_about_an_open_stream_go_to_its_instance_however_many_runs_follow() -> None:
    """After a thousand further requests its stop went to any instance, which knew no such stream."""
    with _asking("one", "other") as exchange:
        for name in ("one", "other"):
            exchange.hold(f"stream-{name}", name)
        for number in range(2 * MAX_REMEMBERED_RUNS):
            exchange.remember(f"{number}", "one")
        for name in ("one", "other"):
            stop = Question(f"streams/stream-{name}/stop", bytes, request_id=f"stream-{name}", timeout=ANSWERED_WITHIN)
            assert await_answer(exchange.ask(stop)) == name.encode()
            exchange.release(f"stream-{name}")
        for number in range(MAX_REMEMBERED_RUNS):
            exchange.remember(f"further {number}", "one")
        with pytest.raises(KeyError):
            exchange.instance_of("stream-other")


def test_a_burst_is_spread_though_nobody_told_anything_yet() -> None:
    loads, asked = Loads(), []
    for _ in range(8):
        least = loads.least({"a", "b"}, "b")
        loads.begin(least)
        asked.append(least)
    assert Counter(asked) == {"a": 4, "b": 4}
    assert asked[0] == "b", "of those that are equal the preferred one"
    for name in asked:
        loads.end(name)
    assert loads.least({"a", "b"}, "b") == "b"


def test_what_others_ask_counts_and_ones_own_only_once() -> None:
    loads = Loads()
    loads.begin("a")
    loads.report("a", workers=2, work=1)  # this client's own
    loads.report("b", workers=2, work=2)
    assert loads.least({"a", "b"}, "b") == "a"
    loads.report("a", workers=2, work=5)
    assert loads.least({"a", "b"}, "a") == "b"
    loads.forget("a")
    loads.end("a")
    assert loads.least({"a", "b"}, "b") == "a", "one that came back has nothing to do"
    assert loads.least((), "a") is None


@given(
    st.dictionaries(st.sampled_from("abcd"), st.tuples(st.integers(1, 4), st.integers(0, 9)), min_size=1),
    st.integers(1, 40),
)
def test_nobody_is_given_more_while_another_one_has_less(told: dict[str, tuple[int, int]], burst: int) -> None:
    loads, own = Loads(), Counter[str]()
    for name, (workers, others) in told.items():
        loads.report(name, workers, others)
    for _ in range(burst):
        least = loads.least(told, None)
        shares = {name: (own[name] + others) / workers for name, (workers, others) in told.items()}
        assert shares[least] == min(shares.values())
        loads.begin(least)
        own[least] += 1
