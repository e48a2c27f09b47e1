"""Faults of a payload, told so that they can be mended: the place, and what would be right there."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec
from msgspec import inspect

MOST_NAMED = 40
"""Most choices that are named."""

FEW = 10
"""So many choices are all named, also where one of them may have been meant."""

MOST_KEYS = 1_000
"""Objects with more keys are not searched for the one that is wrong."""

LONGEST = 64
"""Longest part of what was sent that is repeated [characters]."""

OTHER_THAN_VALUES = {inspect.ListType: ("a list",), inspect.NoneType: ("null",)}
"""What may stand where a value of a few may, too."""

Check = Callable[[Any], object]
"""Converts plain data to the message; raises msgspec.ValidationError where it isn't one."""

Step = str | int | None
"""From a value to one inside it: a field or a key, an index, or some key that msgspec doesn't name."""

_STEP = re.compile(r"\.(?P<field>[^.\[\]]+)|\[(?P<index>\d+)\]|\[\.\.\.\]")
_INDEX = re.compile(r"\$\[(\d+)\]")
_VALUE = re.compile(r"Invalid (?:enum )?value (?P<value>.+)", re.DOTALL)
_FIELD = re.compile(r"Object contains unknown field `(?P<field>.+)`", re.DOTALL)
_NAMED = re.compile(r"`(?P<field>[a-z_][a-z0-9_]*(?:[.\[][^`:]*)?)(?:: [^`]*)?`")
_BYTE = re.compile(r" \(byte (?P<byte>\d+)\)$")


def split(text: str) -> tuple[str, str]:
    """The message and the path of what msgspec says; `$` where it names none."""
    message, _, path = text.rpartition(" - at `")
    return (message, path.rstrip("`")) if message else (text, "$")


def of_field(message: str, path: str) -> str:
    """The path of the value that a message of ours is about: it begins with the field's name, in backticks.

    Args:
        message: What is wrong.
        path: Of what holds the field.
    """
    named = _NAMED.match(message)
    return path if named is None else f"{path}.{named['field']}"


def number_out_of_range(payload: bytes) -> tuple[str, str] | None:
    """The path and the text of the first number of a JSON payload that no float can hold; None if there is none."""
    return _first_odd(payload, lambda text: math.isinf(_as_float(text)), lambda _: False)


def no_number(payload: bytes) -> tuple[str, str] | None:
    """The path and the word of the first NaN or Infinity, which aren't JSON; None where it is otherwise malformed."""
    return _first_odd(payload, lambda _: False, lambda _: True)


class _Odd(str):
    """A number's text as it stood in a payload."""


def _first_odd(
    payload: bytes, is_odd: Callable[[str], bool], is_odd_word: Callable[[str], bool]
) -> tuple[str, str] | None:
    """The path and the text of the first number, or word in a number's place, that is odd."""

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
    return _odd_in(plain, "$")


def _odd_in(plain: Any, path: str) -> tuple[str, str] | None:
    if isinstance(plain, _Odd):
        return path, str(plain)
    inner: Iterable[tuple[str, Any]] = ()
    if isinstance(plain, dict):
        inner = ((_written(key), value) for key, value in plain.items())
    elif isinstance(plain, list):
        inner = ((f"[{index}]", value) for index, value in enumerate(plain))
    for step, value in inner:
        if (found := _odd_in(value, f"{path}{step}")) is not None:
            return found
    return None


def _as_float(text: str) -> float:
    try:
        return float(text)
    except OverflowError:
        return math.inf


def explained(text: str, data: Any, kind: Any, check: Check) -> tuple[str, str, list[Any]]:
    """A fault that msgspec found, with the choices there are, and with the key that it leaves out of its path.

    Args:
        text: What it says.
        data: The payload as plain data.
        kind: The message that it should have been.
        check: Converts plain data to that.

    Returns:
        The message, the path of the fault, and all that would be right there: empty where that can't be listed.
    """
    message, path = split(text)
    steps: list[Step] = [
        step["field"] or (None if step["index"] is None else int(step["index"])) for step in _STEP.finditer(path)
    ]
    if steps.count(None) == 1:
        key = _wrong_key(text, steps, data, check)
        path = path if key is None else path.replace("[...]", _written(key))
        steps = [key if step is None else step for step in steps]
    if (found := _VALUE.fullmatch(message)) is not None:
        values = _values_at(steps, data, kind)
        others = [word for node in _nodes_at(steps, data, kind) for word in OTHER_THAN_VALUES.get(type(node), ())]
        return _advised(message, found["value"].strip("'"), values, repr, others), path, values
    if (found := _FIELD.fullmatch(message)) is not None:
        fields = _fields_at(steps, data, kind)
        return _advised(message, found["field"], fields, "`{}`".format), path, fields
    return message, path, []


def place_in_text(text: str, payload: bytes) -> str:
    """Return msgspec's message about bytes that are no JSON, with line and column instead of the byte."""
    if not payload.strip():
        return "it is empty"
    found = _BYTE.search(text)
    if found is None:
        return text
    before = payload[: int(found["byte"])]
    line, column = before.count(b"\n") + 1, len(before) - before.rfind(b"\n")
    return f"{text[: found.start()]} (line {line}, column {column})"


def nearest(said: str, choices: Iterable[str]) -> list[str]:
    """Those choices that may have been meant, the likeliest first."""
    lowered = {choice.lower(): choice for choice in choices}
    return [lowered[near] for near in difflib.get_close_matches(said[:LONGEST].lower(), lowered, n=3, cutoff=0.6)]


def meant(said: str, choices: Sequence[str]) -> str:
    """A question that names those choices that may have been meant, and a space; empty without one."""
    near = nearest(said, choices)
    return f"did you mean {' or '.join(near)}? " if near else ""


def listed(choices: Sequence[str]) -> str:
    """Choices in a row, the first `MOST_NAMED`, and how many more there are."""
    more = f" and {len(choices) - MOST_NAMED} more" if len(choices) > MOST_NAMED else ""
    return f"{', '.join(choices[:MOST_NAMED])}{more}"


def _advised(
    message: str, said: str, choices: Sequence[Any], written: Callable[[Any], str], others: Sequence[str] = ()
) -> str:
    near = nearest(said, [choice for choice in choices if isinstance(choice, str)])
    advice = f"; did you mean {' or '.join(map(written, near))}?" if near else ""
    if choices and (len(choices) <= FEW or not near):
        more = f" and {len(choices) - MOST_NAMED} more" if len(choices) > MOST_NAMED else ""
        advice += f"{'' if near else ';'} valid: {', '.join([*map(written, choices[:MOST_NAMED]), *others])}{more}"
    return message + advice


def _values_at(steps: Sequence[Step], data: Any, kind: Any) -> list[Any]:
    """The values that may stand at a place: those of a literal, or the tags of the messages that hold it."""
    literals = [node for node in _nodes_at(steps, data, kind) if isinstance(node, inspect.LiteralType)]
    if literals or not steps:
        return [value for literal in literals for value in literal.values]
    holders = _structs(_nodes_at(steps[:-1], data, kind))
    return [holder.tag for holder in holders if holder.tag_field == steps[-1] and holder.tag is not None]


def _fields_at(steps: Sequence[Step], data: Any, kind: Any) -> list[str]:
    structs = _chosen(_structs(_nodes_at(steps, data, kind)), _value_at(steps, data))
    return list(dict.fromkeys(field.encode_name for struct in structs for field in struct.fields))


def _nodes_at(steps: Sequence[Step], data: Any, kind: Any) -> list[inspect.Type]:
    """The types that may stand at a place, as far as the tags in the data tell."""
    nodes = _flat(inspect.type_info(kind))
    for step in steps:
        fields = [field for struct in _chosen(_structs(nodes), data) for field in struct.fields]
        following = [field.type for field in fields if field.encode_name == step]
        following += [node.value_type for node in nodes if isinstance(node, inspect.DictType)]
        following += [node.item_type for node in nodes if isinstance(node, inspect.ListType)]
        nodes, data = [one for node in following for one in _flat(node)], _inside(data, step)
    return nodes


def _flat(node: inspect.Type) -> list[inspect.Type]:
    if isinstance(node, inspect.Metadata):
        return _flat(node.type)
    return [one for part in node.types for one in _flat(part)] if isinstance(node, inspect.UnionType) else [node]


def _structs(nodes: Iterable[inspect.Type]) -> list[inspect.StructType]:
    return [node for node in nodes if isinstance(node, inspect.StructType)]


def _chosen(structs: list[inspect.StructType], data: Any) -> list[inspect.StructType]:
    """Those that the tag in the data chooses; all of them where the data has none."""
    tags = data if isinstance(data, dict) else {}
    return [one for one in structs if one.tag_field is None or tags.get(one.tag_field, one.tag) == one.tag]


def _inside(data: Any, step: Step) -> Any:
    if isinstance(data, dict):
        return data.get(step)
    if isinstance(data, list | tuple) and isinstance(step, int) and step < len(data):
        return data[step]
    return None


def _value_at(steps: Sequence[Step], data: Any) -> Any:
    for step in steps:
        data = _inside(data, step)
    return data


def _wrong_key(text: str, steps: Sequence[Step], data: Any, check: Check) -> str | None:
    """The key that msgspec doesn't name, found by halving the object that has it; None if it can't be told."""
    before = steps[: steps.index(None)]
    within = _value_at(before, data)
    if not isinstance(within, dict) or not 0 < len(within) <= MOST_KEYS:
        return None
    keys = list(within)
    while len(keys) > 1:
        first, rest = keys[: len(keys) // 2], keys[len(keys) // 2 :]
        keys = first if _fails_alike(text, _with_only(first, before, data), check) else rest
    found = isinstance(keys[0], str) and _fails_alike(text, _with_only(keys, before, data), check)
    return keys[0] if found else None


def _with_only(keys: list[Any], steps: Sequence[Step], data: Any) -> Any:
    """The data with nothing but some keys in the object at a place."""
    if not steps:
        return {key: data[key] for key in keys}
    inner = _with_only(keys, steps[1:], _inside(data, steps[0]))
    if isinstance(data, dict):
        return {**data, steps[0]: inner}
    return [inner if index == steps[0] else item for index, item in enumerate(data)]


def _fails_alike(text: str, data: Any, check: Check) -> bool:
    try:
        check(data)
    except msgspec.ValidationError as error:
        return str(error) == text
    return False


def _written(key: str) -> str:
    return f".{key}" if re.fullmatch(r"[\w-]{1,64}", key) else f"[{key[:LONGEST]!r}]"
