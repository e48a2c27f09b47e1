"""JSON Schema of every message, with what each field means, and a message as a table for people.

Descriptions are read from the docstrings of messages: the text before the first section, and each line of `Attributes`.
"""

from __future__ import annotations

import functools
import inspect
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import msgspec

from guidefield.messages import replies, requests
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneChanged, SceneDiff
from guidefield.messages.stream_requests import StreamMessage

MESSAGES: tuple[type[msgspec.Struct], ...] = (
    requests.PlanRequest,
    *requests.TaggedRequest.__args__,
    *replies.AnyReply.__args__,
    replies.ErrorReply,
    Scene,
    SceneDiff,
    SceneChanged,
    *StreamMessage.__args__,
)
"""All messages that have a schema in `info` and docs/wire.schema.json.

Requests, replies and messages about streams come with their unions; any other message is added here.
"""

_MEANING = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*)$")


@functools.cache
def make_schemas() -> dict[str, Any]:
    """Make the JSON Schema of every message that travels: references under ``messages``, all parts under ``$defs``."""
    references, parts = make_schemas_of(MESSAGES)
    return {
        "messages": {kind.__name__: one for kind, one in zip(MESSAGES, references, strict=True)},
        "$defs": parts,
    }


def make_schemas_of(kinds: Sequence[type[msgspec.Struct]]) -> tuple[tuple[dict[str, Any], ...], dict[str, Any]]:
    """Make references to the schemas of messages, and all that these are made of, by name.

    A schema's description is what the docstring says before it comes to fields; a field's is what it says of the field.
    """
    references, parts = msgspec.json.schema_components(kinds)
    by_name = {kind.__name__: kind for kind in _find_structs(msgspec.inspect.multi_type_info(kinds))}
    for name, schema in parts.items():
        schema["description"] = _summarize(by_name[name])
        meanings = _read_meanings(by_name[name])
        if (tag := by_name[name].__struct_config__.tag_field) is not None:
            meanings.setdefault(tag, "says which message it is")
        for field, value in schema.get("properties", {}).items():
            if field in meanings:
                value["description"] = meanings[field]
    return references, parts


def write_schemas() -> str:
    """Write the schemas as JSON, a line for each message, so that a change shows where it is."""
    schemas = make_schemas()
    lines = (
        f"{json.dumps(name)}: {json.dumps(one, ensure_ascii=False)}" for name, one in sorted(schemas["$defs"].items())
    )
    head = json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema"})[1:-1]
    return f'{{{head}, "messages": {json.dumps(schemas["messages"])}, "$defs": {{\n' + ",\n".join(lines) + "\n}}\n"


def describe_message(name: str) -> str:
    """Describe a message, and each field of it, in Markdown; raises KeyError where there is no such message."""
    schema = make_schemas()["$defs"][name]
    required = schema.get("required", ())
    rows = [
        (
            f"`{field}`",
            _name_value(one),
            "" if field in required else _format_default(one),
            one.get("description", "says which message it is" if list(one) == ["enum"] else ""),
        )
        for field, one in schema.get("properties", {}).items()
    ]
    return f"# {name}\n\n{schema['description']}\n" + (
        f"\n{make_table(('field', 'is', 'default', 'meaning'), rows)}\n" if rows else ""
    )


def make_table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Make a table in Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _find_structs(kinds: Sequence[msgspec.inspect.Type]) -> set[type[msgspec.Struct]]:
    found: set[type[msgspec.Struct]] = set()
    left: list[Any] = list(kinds)
    while left:
        kind = left.pop()
        if isinstance(kind, msgspec.inspect.StructType):
            if kind.cls in found:
                continue
            found.add(kind.cls)
            left += [field.type for field in kind.fields]
        for inner in ("type", "item_type", "value_type", "item_types", "types"):
            below = getattr(kind, inner, ())
            left += below if isinstance(below, tuple) else [below]
    return found


def _summarize(message: type) -> str:
    text = re.split(r"\n(?:Attributes|Examples):\n", inspect.cleandoc(message.__doc__ or ""))[0]
    return re.sub(r"\s*\n\s*", " ", text).replace("``", "`").strip()


def _read_meanings(message: type) -> dict[str, str]:
    found: dict[str, str] = {}
    for kind in reversed(message.__mro__):
        if kind.__doc__ and kind.__module__.startswith("guidefield"):
            section = inspect.cleandoc(kind.__doc__).partition("Attributes:\n")[2].partition("\nExamples:")[0]
            names: list[str] = []
            for line in section.splitlines():
                if match := _MEANING.match(line):
                    names = match[1].split(", ")
                    found.update(dict.fromkeys(names, match[2]))
                elif line.strip():
                    for name in names:
                        found[name] += f" {line.strip()}"
                else:
                    names = []
    return found


def _name_value(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"].rpartition("/")[2])
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if "anyOf" in schema:
        null_last = sorted(_list_alternatives(schema), key=lambda one: one.get("type") == "null")
        words = [_name_value(one) for one in null_last]
        return " or ".join(f"({one})" if " or " in one else one for one in words)
    return _NAMES[schema.get("type", "anything")](schema)


def _list_alternatives(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for one in schema["anyOf"]:
        yield from _list_alternatives(one) if "anyOf" in one else (one,)


def _format_default(schema: dict[str, Any]) -> str:
    """Format a default as JSON in code; a message of which every field has its own default is `{}`."""
    if "default" not in schema:
        return ""
    default = schema["default"]
    if isinstance(default, dict) and "$ref" in schema:
        fields = make_schemas()["$defs"][schema["$ref"].rpartition("/")[2]]["properties"]
        default = {name: value for name, value in default.items() if value != fields[name].get("default")}
    return f"`{json.dumps(default, separators=(',', ':'))}`"


def _name_text(schema: dict[str, Any]) -> str:
    if "pattern" in schema:
        return f"`{schema['pattern']}`"
    if "contentEncoding" in schema:
        return "bytes (base64 in JSON)"
    return f"text{_format_lengths(schema.get('minLength', 0), schema.get('maxLength'), ' characters')}"


def _name_list(schema: dict[str, Any]) -> str:
    if "prefixItems" in schema:
        return f"[{', '.join(map(_name_value, schema['prefixItems']))}]"
    lengths = _format_lengths(schema.get("minItems", 0), schema.get("maxItems"), "")
    return f"list of {_bracket(_name_value(schema.get('items', {})))}{lengths}"


def _name_number(schema: dict[str, Any]) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = (f" {sign} {schema[key]:.15g}" for key, sign in signs.items() if key in schema)
    return f"{schema['type']}{','.join(bounds)}"


def _bracket(words: str) -> str:
    return f"({words})" if " or " in words or " (" in words else words


def _format_lengths(least: int, most: int | None, what: str) -> str:
    if most is not None:
        return f" ({least} to {most:,}{what})"
    return f" (at least {least}{what})" if least else ""


_NAMES: dict[str, Callable[[dict[str, Any]], str]] = {
    "anything": lambda _: "anything",
    "array": _name_list,
    "boolean": lambda _: "true or false",
    "integer": _name_number,
    "null": lambda _: "null",
    "number": _name_number,
    "object": lambda schema: f"object of names to {_bracket(_name_value(schema.get('additionalProperties') or {}))}",
    "string": _name_text,
}
"""Words for each kind of value."""
