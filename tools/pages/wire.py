"""The tables of the page about the wire, made of what the code declares."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import msgspec

from guidefield.endpoint.rules import DELIVERY, limits_told
from guidefield.endpoint.service import DEFAULT_GRACE, DEFAULT_QUEUE, DEFAULT_STREAMS, limits_of
from guidefield.messages import replies, requests, scene, scene_changes, stream_requests, streams
from guidefield.messages.served import CODES, KEYS, KeyInfo
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.stores.runs import DEFAULT_RETENTION
from pages.fields import fields, parts, summary

BLOCK = re.compile(r"(<!-- made from the code: (?P<name>[a-z ]+) -->\n)(?P<text>.*?)(<!-- end -->)", re.DOTALL)
"""A part of the page that is made here."""
ROOMS = (requests, replies, scene, scene_changes, streams, stream_requests)


def filled(page: str) -> str:
    """The page with its made parts as the code has them now.

    Raises:
        KeyError: if a part has a name that isn't known here.
    """
    return BLOCK.sub(lambda block: f"{block[1]}\n{PARTS[block['name']]()}\n\n{block[4]}", page)


def keys() -> str:
    """Every key: what it is for, its parameters, what it takes and gives, and whether it waits for a worker."""
    return _table(
        ("key", "what", "parameters", "takes", "gives", "needs a worker"),
        (
            (
                f"`guidefield/<i>/{key.key}`",
                key.what,
                "; ".join(f"`{name}`: {what}" for name, what in key.parameters.items()),
                _named(key.takes),
                _gives(key),
                key.worker if key.how == "query" else "",
            )
            for key in KEYS
        ),
    )


def _gives(key: KeyInfo) -> str:
    if key.how == "token":
        return "liveliness token"
    if key.how == "put":
        return "is put by clients"
    given = _named(key.gives) or "bytes"
    return f"publishes {given}" if key.how == "published" else given


def _named(names: Iterable[str]) -> str:
    return ", ".join(f"[{name}](#{name.lower()})" for name in names)


def codes() -> str:
    """Every code."""
    return _table(
        ("code", "name", "travels as", "exception", "meaning"),
        (
            (str(one.code), f"`{one.name}`", one.travels, f"`{one.exception}`" if one.exception else "", one.meaning)
            for one in CODES
        ),
    )


def limits() -> str:
    """Every limit of a service that was started without options."""
    told = limits_told(limits_of(DEFAULT_QUEUE), DEFAULT_MEMORY, DEFAULT_RETENTION, DEFAULT_GRACE, DEFAULT_STREAMS)
    return _table(
        ("limit", "value", "what"), ((f"`{one.name}`", f"{_figure(one.value)} {one.unit}", one.what) for one in told)
    )


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value == int(value) and value < 1e15 else f"{value:g}"


def delivery() -> str:
    """Every rule by which queries are answered."""
    return "\n".join("\n  ".join(_lines(f"- **{rule.name}**: {rule.rule}", 116)) for rule in DELIVERY)


def messages() -> str:
    """Every message that a key takes or gives, and what they are made of."""
    taken = [_message(name) for key in KEYS for name in key.takes]
    given = [_message(name) for key in KEYS for name in key.gives] + [replies.ErrorReply]
    known = {*taken, *given}
    within = _within(known) - known
    groups = (("Requests", taken), ("Replies", given), ("What they are made of", within))
    return "\n\n".join(
        f"### {title}\n\n" + "\n\n".join(map(_described, sorted(set(group), key=lambda kind: kind.__name__)))
        for title, group in groups
    )


def _message(name: str) -> type[msgspec.Struct]:
    return next(getattr(room, name) for room in ROOMS if hasattr(room, name))


def _within(kinds: set[type[msgspec.Struct]]) -> set[type[msgspec.Struct]]:
    """The messages that others are made of, all the way down."""
    found: set[type[msgspec.Struct]] = set()
    left = list(kinds)
    while left:
        for part in parts(left.pop()):
            if part not in found:
                found.add(part)
                left.append(part)
    return found


def _described(kind: type[msgspec.Struct]) -> str:
    head = "\n".join((f"#### {kind.__name__}", "", *_lines(summary(kind), 118)))
    told = fields(kind)
    if not told:
        return head
    rows = [(f"`{one.name}`", one.kind, one.default, one.meaning) for one in told]
    return f"{head}\n\n{_table(('field', 'is', 'default', 'meaning'), rows)}"


def _lines(text: str, width: int) -> Iterator[str]:
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            yield line
            line = word
        else:
            line = f"{line} {word}".strip()
    yield line


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


PARTS = {"keys": keys, "codes": codes, "limits": limits, "delivery": delivery, "messages": messages}
"""The parts of the page that are made here, by their names on it."""
