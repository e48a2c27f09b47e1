"""Long lists as they are given in Python: taken out of a message, and read some at a time."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages import codec, faults
from guidefield.messages.values import Look

OBJECTS = 500
"""So many obstacles or placements are read at one go, in a few milliseconds."""


@dataclasses.dataclass(frozen=True)
class Long:
    """A field that may hold very many, which is taken out of a message.

    Attributes:
        all: The type of the list.
        read: Reads them, given how they are given, this, their path, and the look.
        most: How many there may be; of more the reader of the rest says so.
        least: How many there must be; of fewer it says so, too.
        stand_in: What is sound in its place.
        kind: What it is given as, beside an array.
        inner: How many parts one has besides that may be long.
        together: So many are read at one go, in some milliseconds.
        require: Raises ValueError where one isn't sound that was read, given the field's name, all, and the look.
    """

    all: Any
    read: Callable[[Any, Long, str, Look], Any]
    most: float = float("inf")
    least: int = 1
    stand_in: Any = ()
    kind: type = list
    inner: Callable[[Any], int] = lambda _: 0
    together: int = OBJECTS
    require: Callable[[str, Any, Look], None] | None = None

    def holds(self, given: Any) -> bool:
        """Whether what is given may be read some at a time."""
        if self.kind is dict:
            return isinstance(given, dict) and len(given) <= self.most
        return are_rows(given) and self.least <= count(given) <= self.most


def listed(given: Sequence[Any], what: Long, at: str, look: Look) -> list[Any]:
    """What is small each; `at` is the path of their list."""
    made = list[Any]()
    for begin in range(0, len(given), what.together):
        some: Any = given[begin : begin + what.together]
        plain = some.tolist() if hasattr(some, "tolist") else some
        if any(isinstance(one, msgspec.Struct) for one in plain):
            plain = codec.without_arrays(plain)
        made += codec.convert(plain, what.all, at, begin)
        look()
    return made


def by_name(given: Mapping[str, Any], what: Long, at: str, look: Look) -> dict[str, Any]:
    """The same of what has names."""
    made, names = dict[str, Any](), [*given]
    for begin in range(0, len(names), what.together):
        some = {name: given[name] for name in names[begin : begin + what.together]}
        plain = codec.without_arrays(some) if any(isinstance(one, msgspec.Struct) for one in some.values()) else some
        made |= codec.convert(plain, what.all, at)
        look()
    return made


def require(check: Callable[[], object], at: str) -> None:
    """Check what was put together, which has a path, as msgspec does what it makes."""
    try:
        check()
    except ValueError as error:
        path = faults.of_field(str(error), at)
        raise MalformedRequest(f"{error} (at {path})", path=path) from None


def without_structs(given: Any) -> Any:
    """A message as plain data; where it is a dict already numbers of NumPy's may stand in it."""
    return given if isinstance(given, dict) else codec.without_arrays(given)


def count(rows: Any) -> int:
    """How many rows there are; 0 of what isn't in rows."""
    return len(rows) if are_rows(rows) else 0


def are_rows(given: Any) -> bool:
    """Whether anything is a list, or an array of NumPy's."""
    return isinstance(given, list | tuple) or (hasattr(given, "tolist") and bool(getattr(given, "shape", None)))


def get(holder: Any, field: str) -> Any:
    """What stands in a field of a dict or message; None if nothing does."""
    return holder.get(field) if isinstance(holder, dict) else getattr(holder, field, None)


def with_fields(holder: Any, fields: dict[str, Any]) -> Any:
    """A dict or message with some fields as they are given, unchecked."""
    if isinstance(holder, dict):
        return {**holder, **fields}
    other = copy.copy(holder)
    for field, value in fields.items():
        msgspec.structs.force_setattr(other, field, value)
    return other
