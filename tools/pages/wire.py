"""The tables of the page about the wire, made of what the code declares."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from guidefield.endpoint.rules import DELIVERY, list_limits
from guidefield.endpoint.service import DEFAULT_GRACE, DEFAULT_QUEUE, limits_of
from guidefield.messages.keys import KEYS
from guidefield.messages.schemas import make_table
from guidefield.messages.service import CODES, CodeInfo, KeyInfo
from guidefield.messages.streams import DEFAULT_STREAMS
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.stores.runs import DEFAULT_RETENTION

BLOCK = re.compile(r"(<!-- made from the code: (?P<name>[a-z ]+) -->\n)(?P<text>.*?)(<!-- end -->)", re.DOTALL)
"""A part of the page that is made here."""


def fill(page: str) -> str:
    """The page with its made parts as the code has them now.

    Raises:
        KeyError: if a part has a name that isn't known here.
    """
    return BLOCK.sub(lambda block: f"{block[1]}\n{PARTS[block['name']]()}\n\n{block[4]}", page)


def keys() -> str:
    """Every key: its purpose and parameters, whether it waits for a worker, what it takes and gives.

    A parameter is explained at the first key that has it.
    """
    explained = set[tuple[str, str]]()

    def explain(name: str, what: str) -> str:
        known = (name, what) in explained
        explained.add((name, what))
        return f"`?{name}`" if known else f"`?{name}`: {what}"

    return make_table(
        ("key", "purpose and parameters", "takes → gives"),
        (
            (
                f"`guidefield/<i>/{key.key}`",
                "; ".join([key.what, *(explain(name, what) for name, what in key.parameters.items()), *_worker(key)]),
                " → ".join(filter(None, (_named(key.takes), _gives(key)))),
            )
            for key in KEYS
        ),
    )


def _worker(key: KeyInfo) -> tuple[str, ...]:
    match key.worker:
        case "never":
            return ()
        case "always":
            return ("**worker**",)
        case when:
            return (f"**worker** {when}",)


def _gives(key: KeyInfo) -> str:
    if key.how == "token":
        return "liveliness token"
    if key.how == "put":
        return "put by clients"
    given = _named(key.gives) or "bytes"
    return f"publishes {given}" if key.how == "published" else given


def _named(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def codes() -> str:
    """Every code."""
    return make_table(
        ("code", "name (travels as)", "meaning"),
        ((str(one.code), f"`{one.name}` ({_travels(one)})", one.meaning) for one in CODES),
    )


def _travels(code: CodeInfo) -> str:
    return f"{code.travels}: `{code.exception}`" if code.exception else code.travels


def limits() -> str:
    """Every limit of a service that was started without options."""
    told = list_limits(limits_of(DEFAULT_QUEUE), DEFAULT_MEMORY, DEFAULT_RETENTION, DEFAULT_GRACE, DEFAULT_STREAMS)
    return make_table(
        ("limit", "of or for"),
        ((f"`{one.name}`: {_figure(one.value)} {one.unit}", one.what) for one in told),
    )


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value == int(value) and value < 1e15 else f"{value:g}"


def delivery() -> str:
    """Every rule by which queries are answered."""
    return "\n".join("\n  ".join(_lines(f"- **{rule.name}**: {rule.rule}", 116)) for rule in DELIVERY)


def _lines(text: str, width: int) -> Iterator[str]:
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            yield line
            line = word
        else:
            line = f"{line} {word}".strip()
    yield line


PARTS = {"keys": keys, "codes": codes, "limits": limits, "delivery": delivery}
"""The parts of the page that are made here, by their names on it."""
