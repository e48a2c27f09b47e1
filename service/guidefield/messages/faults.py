"""Explain faults of a payload: the place, and the valid choices there.

The patterns below read msgspec's messages: with a message that it words otherwise, the text stays as msgspec has it.
`_NAMED` reads those of our own checks, too: a field in backticks at their beginning becomes the path of the error.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec
from msgspec import inspect

MAX_LISTED = 40
"""The largest number of choices that a message lists."""

MAX_FULLY_LISTED = 10
"""The largest number of choices that are all listed although one of them resembles the wrong word."""

MAX_SEARCHED_KEYS = 1_000
"""Objects with more keys aren't searched for the wrong one."""

MAX_QUOTED_CHARACTERS = 64
"""Longest part of the payload that a message quotes [characters]."""

ALTERNATIVES = {inspect.ListType: ("a list",), inspect.NoneType: ("null",)}
"""Words for the other types of a union with a literal; a type without words isn't listed."""

Check = Callable[[Any], object]
"""Converts plain data to the message; raises msgspec.ValidationError where it isn't one."""

Step = str | int | None
"""A step of a path into a value: a field or key, an index, or None for a key that msgspec leaves out."""

_STEP = re.compile(r"\.(?P<field>[^.\[\]]+)|\[(?P<index>\d+)\]|\[\.\.\.\]")
_VALUE = re.compile(r"Invalid (?:enum )?value (?P<value>.+)", re.DOTALL)
_FIELD = re.compile(r"Object contains unknown field `(?P<field>.+)`", re.DOTALL)
_NAMED = re.compile(r"`(?P<field>[a-z_][a-z0-9_]*(?:[.\[][^`:]*)?)(?:: [^`]*)?`")
_BYTE = re.compile(r" \(byte (?P<byte>\d+)\)$")


def split_message(text: str) -> tuple[str, str]:
    """Split msgspec's text into message and path; `$` if it has no path."""
    message, _, path = text.rpartition(" - at `")
    return (message, path.rstrip("`")) if message else (text, "$")


def field_path(message: str, path: str) -> str:
    """Return the path of the field, of the object at a path, that a message begins with in backticks; else the path."""
    named = _NAMED.match(message)
    return path if named is None else f"{path}.{named['field']}"


def find_number_out_of_range(payload: bytes) -> tuple[str, str] | None:
    """Return path and text of the first number of a JSON payload that overflows a float; None if there is none."""
    return _find_first_odd(payload, lambda text: math.isinf(_parse_float(text)), lambda _: False)


def find_nonfinite_word(payload: bytes) -> tuple[str, str] | None:
    """Return path and word of the first NaN or Infinity, which aren't JSON; None if it is otherwise malformed."""
    return _find_first_odd(payload, lambda _: False, lambda _: True)


class _Odd(str):
    """The text of a number in a payload."""


def _find_first_odd(
    payload: bytes, is_odd: Callable[[str], bool], is_odd_word: Callable[[str], bool]
) -> tuple[str, str] | None:
    def number(text: str) -> Any:
        return _Odd(text) if is_odd(text) else 0

    try:
        plain = json.loads(
            payload,
            parse_float=number,
            parse_int=number,
            parse_constant=lambda word: _Odd(word) if is_odd_word(word) else 0,
        )
    except (ValueError, RecursionError):
        return None
    return _find_odd(plain, "$")


def _find_odd(plain: Any, path: str) -> tuple[str, str] | None:
    if isinstance(plain, _Odd):
        return path, str(plain)
    inner: Iterable[tuple[str, Any]] = ()
    if isinstance(plain, dict):
        inner = ((_format_key(key), value) for key, value in plain.items())
    elif isinstance(plain, list):
        inner = ((f"[{index}]", value) for index, value in enumerate(plain))
    for step, value in inner:
        if (found := _find_odd(value, f"{path}{step}")) is not None:
            return found
    return None


def _parse_float(text: str) -> float:
    try:
        return float(text)
    except OverflowError:
        return math.inf


def explain(text: str, data: Any, kind: Any, check: Check) -> tuple[str, str, list[Any]]:
    """Add the valid choices, and the key that msgspec leaves out of the path, to msgspec's description of a fault.

    Returns:
        The message, the path of the fault, and the valid choices: empty if they can't be listed.
    """
    message, path = split_message(text)
    steps: list[Step] = [
        step["field"] or (None if step["index"] is None else int(step["index"])) for step in _STEP.finditer(path)
    ]
    if steps.count(None) == 1:
        key = _wrong_key(text, steps, data, check)
        path = path if key is None else path.replace("[...]", _format_key(key))
        steps = [key if step is None else step for step in steps]
    if (found := _VALUE.fullmatch(message)) is not None:
        values = _values_at(steps, data, kind)
        others = [word for node in _nodes_at(steps, data, kind) for word in ALTERNATIVES.get(type(node), ())]
        return _add_advice(message, found["value"].strip("'"), values, repr, others), path, values
    if (found := _FIELD.fullmatch(message)) is not None:
        fields = _fields_at(steps, data, kind)
        return _add_advice(message, found["field"], fields, "`{}`".format), path, fields
    if isinstance(number := _value_at(steps, data), float) and not math.isfinite(number):
        message = f"a finite number is needed, not {number}"
    return message, path, []


def locate_in_text(text: str, payload: bytes) -> str:
    """Return msgspec's message about malformed JSON with line and column instead of the byte."""
    if not payload.strip():
        return "it is empty"
    found = _BYTE.search(text)
    if found is None:
        return text
    before = payload[: int(found["byte"])]
    line, column = before.count(b"\n") + 1, len(before) - before.rfind(b"\n")
    return f"{text[: found.start()]} (line {line}, column {column})"


def find_nearest(said: str, choices: Iterable[str]) -> list[str]:
    """Return the choices that resemble a word, the most similar first."""
    lowered = {choice.lower(): choice for choice in choices}
    word = said[:MAX_QUOTED_CHARACTERS].lower()
    return [lowered[near] for near in difflib.get_close_matches(word, lowered, n=3, cutoff=0.6)]


def suggest(said: str, choices: Sequence[str]) -> str:
    """Ask whether one of the choices that resemble a word was meant, with a space behind; empty if none does."""
    near = find_nearest(said, choices)
    return f"did you mean {' or '.join(near)}? " if near else ""


def list_choices(choices: Sequence[str]) -> str:
    """List the first `MAX_LISTED` choices, and the number of the others."""
    more = f" and {len(choices) - MAX_LISTED} more" if len(choices) > MAX_LISTED else ""
    return f"{', '.join(choices[:MAX_LISTED])}{more}"


def _add_advice(
    message: str, said: str, choices: Sequence[Any], format_choice: Callable[[Any], str], others: Sequence[str] = ()
) -> str:
    near = find_nearest(said, [choice for choice in choices if isinstance(choice, str)])
    advice = f"; did you mean {' or '.join(map(format_choice, near))}?" if near else ""
    if choices and (len(choices) <= MAX_FULLY_LISTED or not near):
        more = f" and {len(choices) - MAX_LISTED} more" if len(choices) > MAX_LISTED else ""
        advice += (
            f"{'' if near else ';'} valid: {', '.join([*map(format_choice, choices[:MAX_LISTED]), *others])}{more}"
        )
    return message + advice


def _values_at(steps: Sequence[Step], data: Any, kind: Any) -> list[Any]:
    """Return the valid values at a place: those of a literal, or the tags of the messages with this tag field."""
    literals = [node for node in _nodes_at(steps, data, kind) if isinstance(node, inspect.LiteralType)]
    if literals or not steps:
        return [value for literal in literals for value in literal.values]
    holders = _select_structs(_nodes_at(steps[:-1], data, kind))
    return [holder.tag for holder in holders if holder.tag_field == steps[-1] and holder.tag is not None]


def _fields_at(steps: Sequence[Step], data: Any, kind: Any) -> list[str]:
    structs = _match_tag(_select_structs(_nodes_at(steps, data, kind)), _value_at(steps, data))
    return list(dict.fromkeys(field.encode_name for struct in structs for field in struct.fields))


def _nodes_at(steps: Sequence[Step], data: Any, kind: Any) -> list[inspect.Type]:
    """Return the possible types at a place, given the tags in the data."""
    nodes = _flatten(inspect.type_info(kind))
    for step in steps:
        fields = [field for struct in _match_tag(_select_structs(nodes), data) for field in struct.fields]
        following = [field.type for field in fields if field.encode_name == step]
        following += [node.value_type for node in nodes if isinstance(node, inspect.DictType)]
        following += [node.item_type for node in nodes if isinstance(node, inspect.ListType)]
        nodes, data = [one for node in following for one in _flatten(node)], _step_into(data, step)
    return nodes


def _flatten(node: inspect.Type) -> list[inspect.Type]:
    if isinstance(node, inspect.Metadata):
        return _flatten(node.type)
    return [one for part in node.types for one in _flatten(part)] if isinstance(node, inspect.UnionType) else [node]


def _select_structs(nodes: Iterable[inspect.Type]) -> list[inspect.StructType]:
    return [node for node in nodes if isinstance(node, inspect.StructType)]


def _match_tag(structs: list[inspect.StructType], data: Any) -> list[inspect.StructType]:
    tags = data if isinstance(data, dict) else {}
    return [one for one in structs if one.tag_field is None or tags.get(one.tag_field, one.tag) == one.tag]


def _step_into(data: Any, step: Step) -> Any:
    if isinstance(data, dict):
        return data.get(step)
    if isinstance(data, list | tuple) and isinstance(step, int) and step < len(data):
        return data[step]
    return None


def _value_at(steps: Sequence[Step], data: Any) -> Any:
    for step in steps:
        data = _step_into(data, step)
    return data


def _wrong_key(text: str, steps: Sequence[Step], data: Any, check: Check) -> str | None:
    """Find the key that msgspec leaves out, by bisection of the object's keys; None if that fails."""
    before = steps[: steps.index(None)]
    within = _value_at(before, data)
    if not isinstance(within, dict) or not 0 < len(within) <= MAX_SEARCHED_KEYS:
        return None
    keys = list(within)
    while len(keys) > 1:
        first, rest = keys[: len(keys) // 2], keys[len(keys) // 2 :]
        keys = first if _fails_alike(text, _keep_keys(first, before, data), check) else rest
    found = isinstance(keys[0], str) and _fails_alike(text, _keep_keys(keys, before, data), check)
    return keys[0] if found else None


def _keep_keys(keys: list[Any], steps: Sequence[Step], data: Any) -> Any:
    if not steps:
        return {key: data[key] for key in keys}
    inner = _keep_keys(keys, steps[1:], _step_into(data, steps[0]))
    if isinstance(data, dict):
        return {**data, steps[0]: inner}
    return [inner if index == steps[0] else item for index, item in enumerate(data)]


def _fails_alike(text: str, data: Any, check: Check) -> bool:
    try:
        check(data)
    except msgspec.ValidationError as error:
        return str(error) == text
    return False


def _format_key(key: str) -> str:
    return f".{key}" if re.fullmatch(r"[\w-]{1,64}", key) else f"[{key[:MAX_QUOTED_CHARACTERS]!r}]"
