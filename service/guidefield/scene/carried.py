"""What is made of a scene is carried over to what a change makes of it: only rows of other obstacles are made anew.

A table that is carried over is the very one, to the last bit, that would be made of the changed scene alone. That of
the scene before stays as it is.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from guidefield.kept import MISSING, Answers

FEW = 0.25
"""Where more of the obstacles than this share are others, all is sooner made anew."""

Rest = ParamSpec("Rest")
Table = TypeVar("Table")
Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class Rows:
    """Where the obstacles of a scene stood in the one that it was changed from.

    Attributes:
        source: Index there of each obstacle, -1 of one that is another, shape (n,).
        before: How many obstacles there were.
    """

    source: np.ndarray
    before: int

    @cached_property
    def fresh(self) -> np.ndarray:
        """Which are others, ascending indices, shape (k,)."""
        return np.flatnonzero(self.source < 0)

    @cached_property
    def in_place(self) -> bool:
        """Whether those that stayed stand where they stood, and there are as many as before."""
        return len(self.source) == self.before and bool(
            ((self.source < 0) | (self.source == np.arange(self.before))).all()
        )

    @property
    def are_few(self) -> bool:
        """Whether so few are others that tables are worth to be carried over."""
        return len(self.fresh) <= FEW * len(self.source)

    def of(self, rows: np.ndarray, fresh: np.ndarray) -> np.ndarray:
        """Rows of obstacles, of shape (n, ...), made of those of the obstacles before, with those of the others put in.

        Args:
            rows: One of each obstacle before, shape (m, ...).
            fresh: One of each of the others, shape (k, ...).
        """
        carried: np.ndarray = rows.copy() if self.in_place else np.take(rows, self.source, axis=0)
        carried[self.fresh] = fresh
        return carried

    def listed(self, values: Sequence[Value], fresh: Sequence[Value]) -> list[Value]:
        """The same of a list."""
        if self.in_place:
            carried = [*values]
            for index, value in zip(self.fresh.tolist(), fresh, strict=True):
                carried[index] = value
            return carried
        others, carried = iter(fresh), []
        for begin, count in self._runs:
            if begin < 0:
                carried.append(next(others))
            else:
                carried += values[begin : begin + count]
        return carried

    @cached_property
    def _runs(self) -> list[tuple[int, int]]:
        """Where obstacles stood that stand one behind the other now as before, and how many; -1 of each other one."""
        source = self.source
        begins = np.flatnonzero(np.append(True, (source[:-1] < 0) | (np.diff(source) != 1))[: len(source)])
        counts = np.diff(np.append(begins, len(source)))
        return list(zip(source[begins].tolist(), counts.tolist(), strict=True))

    @cached_property
    def gone(self) -> np.ndarray:
        """Which of those before aren't there any more, ascending indices there, shape (g,)."""
        if self.in_place:
            return self.fresh
        left = np.zeros(self.before, bool)
        left[self.source[self.source >= 0]] = True
        return np.flatnonzero(~left)

    def now(self, before: Sequence[int]) -> list[int]:
        """Where some of those before stand, that are still there."""
        chosen = np.isin(self.source, np.array(before, np.int64)) if before else np.zeros(0, bool)
        return np.flatnonzero(chosen).tolist()

    def after(self, earlier: Rows) -> Rows:
        """Both changes as one, this one the later."""
        stayed = np.append(earlier.source, -1)  # what is another stays another
        return Rows(stayed[self.source], earlier.before)


def note(scene: Any, before: Any, rows: Rows) -> None:
    """Note what a scene was before a change: its obstacles are the same objects as there, where rows say so."""
    _BEFORE[scene] = weakref.ref(before), rows


_BEFORE: weakref.WeakKeyDictionary[Any, tuple[weakref.ref[Any], Rows]] = weakref.WeakKeyDictionary()


def carried(
    over: Callable[Concatenate[Table, Rows, Any, Rest], Table],
) -> Callable[[Callable[Concatenate[Any, Rest], Table]], Callable[Concatenate[Any, Rest], Table]]:
    """Make what a function makes of a scene once, as `kept_with` does; if the scene is a changed one, by `over`.

    Args:
        over: Makes it of that of the scene before, given this, the rows, the scene and what else the function takes.
    """

    def decorated(make: Callable[Concatenate[Any, Rest], Table]) -> Callable[Concatenate[Any, Rest], Table]:
        known = Answers[Table]()

        @functools.wraps(make)
        def made(scene: Any, /, *rest: Rest.args, **options: Rest.kwargs) -> Table:
            asked = (rest, *options.items())
            table = known.of(scene, asked)
            if table is not MISSING:
                return table
            found = _before(scene, known, asked)
            table = make(scene, *rest, **options) if found is None else over(*found, scene, *rest, **options)
            return known.keep(scene, asked, table)

        return made

    return decorated


def _before(scene: Any, known: Answers[Table], asked: object) -> tuple[Table, Rows] | None:
    """The table of the last scene before of which there is one, and the rows from there to here."""
    rows: Rows | None = None
    while scene in _BEFORE:
        before, step = _BEFORE[scene]
        scene, rows = before(), step if rows is None else rows.after(step)
        if scene is None or not rows.are_few:
            return None
        table = known.of(scene, asked)
        if table is not MISSING:
            return table, rows
    return None
