"""The fields of a message as they are declared: what each is called, may be and means."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect as types

MEANING = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*)$")


class Field(NamedTuple):
    """One field: its name on the wire, what it may be, its default ("" where it has to be given), and what it means."""

    name: str
    kind: str
    default: str
    meaning: str


def fields(message: type[msgspec.Struct]) -> list[Field]:
    """The fields of a message; first its tag, if it has one."""
    config, meant = message.__struct_config__, meanings(message)
    tag = [Field(str(config.tag_field), f"`{config.tag}`", "", "says which message it is")] if config.tag else []
    declared = msgspec.structs.fields(message)
    return tag + [
        Field(one.encode_name, in_words(types.type_info(one.type)), _default(one), meant.get(one.name, ""))
        for one in declared
    ]


def meanings(message: type) -> dict[str, str]:
    """What the docstrings of a message, and of those that it extends, say about its fields."""
    found: dict[str, str] = {}
    for kind in reversed(message.__mro__):
        if kind.__doc__ and kind.__module__.startswith("guidefield"):
            section = inspect.cleandoc(kind.__doc__).partition("Attributes:\n")[2].partition("\nExample:")[0]
            names: list[str] = []
            for line in section.splitlines():
                if match := MEANING.match(line):
                    names = match[1].split(", ")
                    found.update(dict.fromkeys(names, match[2]))
                elif line.strip():
                    for name in names:
                        found[name] += f" {line.strip()}"
                else:
                    names = []
    return found


def summary(message: type) -> str:
    """What the docstring of a message says before it comes to its fields."""
    text = re.split(r"\n(?:Attributes|Example):\n", inspect.cleandoc(message.__doc__ or ""))[0]
    return re.sub(r"\s*\n\s*", " ", text).replace("``", "`").strip()


def parts(message: type[msgspec.Struct]) -> Iterator[type[msgspec.Struct]]:
    """The messages that the fields of a message are made of."""
    for field in msgspec.structs.fields(message):
        yield from _structs(types.type_info(field.type))


def _structs(kind: types.Type) -> Iterator[type[msgspec.Struct]]:
    match kind:
        case types.StructType():
            yield kind.cls
        case types.UnionType():
            for one in kind.types:
                yield from _structs(one)
        case types.ListType() | types.VarTupleType():
            yield from _structs(kind.item_type)
        case types.TupleType():
            for one in kind.item_types:
                yield from _structs(one)
        case types.DictType():
            yield from _structs(kind.value_type)
        case types.Metadata():
            yield from _structs(kind.type)


def in_words(kind: types.Type) -> str:
    """What a value may be, in Markdown.

    Raises:
        TypeError: if it is of a kind that no message has had by now.
    """
    for known, words in _WORDS.items():
        if isinstance(kind, known):
            return words(kind)
    raise TypeError(f"a message has a field of a kind that this page doesn't know: {kind}")


def _alternatives(kind: types.UnionType) -> str:
    last = [one for one in kind.types if isinstance(one, types.NoneType)]
    words = [in_words(one) for one in [one for one in kind.types if one not in last] + last]
    return " or ".join(f"({one})" if " or " in one else one for one in words)


def _many(words: str) -> str:
    return f"({words})" if " or " in words or " (" in words else words


def _bounds(kind: types.IntType | types.FloatType) -> str:
    told = [
        f" {sign} {limit:.15g}"
        for sign, limit in ((">", kind.gt), ("≥", kind.ge), ("<", kind.lt), ("≤", kind.le))
        if limit is not None
    ]
    return ",".join(told)


def _lengths(kind: types.StrType | types.ListType, what: str) -> str:
    least, most = kind.min_length or 0, kind.max_length
    if most is not None:
        return f" ({least} to {most:,}{what})"
    return f" (at least {least}{what})" if least else ""


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.default_factory is not msgspec.NODEFAULT:
        value: Any = field.default_factory()
    elif field.default is not msgspec.NODEFAULT:
        value = field.default
    else:
        return ""
    return f"`{msgspec.json.encode(value).decode()}`"


_WORDS: dict[type, Callable[[Any], str]] = {
    types.Metadata: lambda kind: in_words(kind.type),
    types.NoneType: lambda _: "null",
    types.AnyType: lambda _: "anything",
    types.BoolType: lambda _: "true or false",
    types.BytesType: lambda _: "bytes (base64 in JSON)",
    types.IntType: lambda kind: f"integer{_bounds(kind)}",
    types.FloatType: lambda kind: f"number{_bounds(kind)}",
    types.StrType: lambda kind: f"`{kind.pattern}`" if kind.pattern else f"text{_lengths(kind, ' characters')}",
    types.LiteralType: lambda kind: " or ".join(f"`{value}`" for value in sorted(kind.values, key=str)),
    types.StructType: lambda kind: f"[{kind.cls.__name__}](#{kind.cls.__name__.lower()})",
    types.UnionType: _alternatives,
    types.ListType: lambda kind: f"list of {_many(in_words(kind.item_type))}{_lengths(kind, '')}",
    types.TupleType: lambda kind: f"[{', '.join(in_words(one) for one in kind.item_types)}]",
    types.DictType: lambda kind: f"object of names to {_many(in_words(kind.value_type))}",
}
"""How each kind of value is told."""
