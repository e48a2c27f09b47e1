"""Update tables of a scene incrementally: after a change only rows of new obstacles are made.

Whoever decorates a function with `incremental` promises that an updated table is the same, to the last bit, as one that
is made of the changed scene alone, and that the table of the scene before stays as it is. Thresholds are time alone;
from `MANY` obstacles on scenes are also cropped (crop.py).
"""

from __future__ import annotations

import functools
import weakref
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from guidefield.memo import MISSING, Answers

MOST_FRESH = 0.25  # where a larger share of the obstacles is new, building all anew takes less time
MANY = 256  # tables of fewer obstacles are always built anew
MANY_RUNS = 64  # more runs are copied row by row instead of run by run

Rest = ParamSpec("Rest")
Table = TypeVar("Table")
Value = TypeVar("Value")


Run = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Rows:
    """Where a scene's obstacles were in the one that it was changed from; those that stayed keep their order."""

    # of obstacles that stand one behind the other in both: the first one's former index, and their number; of new ones
    # -1 and their number
    runs: Sequence[Run]
    before: int  # how many obstacles there were

    @classmethod
    def of(cls, source: np.ndarray, before: int) -> Rows:
        """Build it from the former index of each obstacle, -1 of a new one, shape (n,)."""
        others = source < 0
        steps = np.where(others[1:], ~others[:-1], others[:-1] | (np.diff(source) != 1))
        begins = np.flatnonzero(np.append(True, steps)[: len(source)])
        counts = np.diff(np.append(begins, len(source)))
        return cls(list(zip(source[begins].tolist(), counts.tolist(), strict=True)), before)

    @classmethod
    def changed(cls, before: int, removed: Iterable[int], moved: Sequence[int], count: int) -> Rows:
        """Build it from a change of `before` obstacles to `count`.

        Given are former indices of removed ones and new indices of those that were replaced in place, both ascending.
        Behind all that are left there are new ones.
        """
        runs, place, others = list[Run](), 0, 0
        for begin, many in _find_between(removed, before):
            at, end = place, place + many
            while others < len(moved) and moved[others] < end:
                runs += [(begin + at - place, moved[others] - at), (-1, 1)]
                at, others = moved[others] + 1, others + 1
            runs.append((begin + at - place, end - at))
            place = end
        return cls(_merge_runs([*runs, (-1, count - place)]), before)

    @cached_property
    def count(self) -> int:
        """Number of obstacles."""
        return sum(count for _, count in self.runs)

    @cached_property
    def source(self) -> np.ndarray:
        """Former index of each obstacle, -1 of a new one, shape (n,)."""
        source, place = np.full(self.count, -1), 0
        for begin, count in self.runs:
            if begin >= 0:
                source[place : place + count] = np.arange(begin, begin + count)
            place += count
        return source

    @cached_property
    def now(self) -> np.ndarray:
        """Index of each former obstacle now, -1 of a removed one, shape (m,)."""
        now, place = np.full(self.before, -1), 0
        for begin, count in self.runs:
            if begin >= 0:
                now[begin : begin + count] = np.arange(place, place + count)
            place += count
        return now

    @cached_property
    def fresh(self) -> list[int]:
        """Indices of new obstacles, ascending."""
        fresh, place = list[int](), 0
        for begin, count in self.runs:
            if begin < 0:
                fresh += range(place, place + count)
            place += count
        return fresh

    @cached_property
    def removed(self) -> list[int]:
        """Former indices of removed obstacles, ascending."""
        gone, end = list[int](), 0
        for begin, count in self.runs:
            if begin >= 0:
                gone += range(end, begin)
                end = begin + count
        return [*gone, *range(end, self.before)]

    @cached_property
    def in_place(self) -> bool:
        """True if those that stayed keep their indices, and the number is the same as before."""
        return self.count == self.before and self.fresh == self.removed

    @property
    def are_few(self) -> bool:
        """True if so few are new that an update pays."""
        return len(self.fresh) <= MOST_FRESH * self.count

    def carry(self, rows: np.ndarray, fresh: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Return rows of all obstacles (n, ...) from those before (m, ...) and new ones (k, ...), in `out` if given.

        There is a row of each new obstacle, and no more.
        """
        carried = np.empty((self.count, *rows.shape[1:]), rows.dtype) if out is None else out
        if len(self.runs) > MANY_RUNS:
            np.take(rows, self.source, axis=0, out=carried, mode="wrap")
            carried[self.fresh] = fresh
            return carried
        place = new = 0
        for begin, count in self.runs:
            if begin < 0:
                carried[place : place + count] = fresh[new : new + count]
                new += count
            else:
                carried[place : place + count] = rows[begin : begin + count]
            place += count
        return carried

    def listed(self, values: Sequence[Value], fresh: Sequence[Value]) -> list[Value]:
        """Return a list of all obstacles' values, as `carry` does."""
        if self.in_place:
            carried = [*values]
            for index, value in zip(self.fresh, fresh, strict=True):
                carried[index] = value
            return carried
        carried, new = [], 0
        for begin, count in self.runs:
            if begin < 0:
                carried += fresh[new : new + count]
                new += count
            else:
                carried += values[begin : begin + count]
        return carried

    def stayed(self, before: Sequence[int]) -> list[int]:
        """Return the indices of some former obstacles that remain, both ascending."""
        if not before:
            return []
        now: list[int] = self.now[np.array(before)].tolist()
        return [index for index in now if index >= 0]

    def among(self, before: np.ndarray, now: np.ndarray) -> Rows:
        """Return the rows among some of the obstacles before, (b,), and now, (k,), both ascending indices."""
        source = self.source[now]
        place = np.minimum(np.searchsorted(before, source), len(before) - 1)
        stood = before[place] == source if len(before) else np.zeros(len(now), bool)
        return Rows.of(np.where(stood, place, -1), len(before))

    def after(self, earlier: Rows) -> Rows:
        """Return both changes as one, this one the later."""
        ends, runs = list(accumulate(count for _, count in earlier.runs)), list[Run]()
        for begin, count in self.runs:
            if begin < 0:
                runs.append((begin, count))
                continue
            at, end, which = begin, begin + count, bisect_right(ends, begin)
            while at < end:
                first, many = earlier.runs[which]
                taken = min(end, ends[which]) - at
                runs.append((first if first < 0 else first + many - (ends[which] - at), taken))
                at, which = at + taken, which + 1
        return Rows(_merge_runs(runs), earlier.before)


def _find_between(some: Iterable[int], count: int) -> Iterator[Run]:
    """Yield the begin and length of each run of indices below `count` that are not among some ascending ones."""
    begin = 0
    for one in some:
        if one > begin:
            yield begin, one - begin
        begin = one + 1
    if begin < count:
        yield begin, count - begin


def _merge_runs(runs: Iterable[Run]) -> list[Run]:
    """Return the runs without empty ones; runs that continue the one before, or are both of new ones, are one."""
    joined = list[Run]()
    for begin, count in runs:
        if not count:
            continue
        last, many = joined[-1] if joined else (-2, 0)
        if begin == (last if begin < 0 else last + many) and (begin < 0) == (last < 0):
            joined[-1] = last, many + count
        else:
            joined.append((begin, count))
    return joined


def note_change(scene: Any, before: Any, rows: Rows) -> None:
    """Note the scene before a change; obstacles that stayed are the same objects, as the rows say."""
    vars(scene)[_BEFORE] = weakref.ref(before), rows


_BEFORE = "_before"  # the attribute of a scene that refers to the scene before its change, which it doesn't keep alive


def incremental(
    update: Callable[Concatenate[Table, Rows, Any, Rest], Table | None],
) -> Callable[[Callable[Concatenate[Any, Rest], Table]], Callable[Concatenate[Any, Rest], Table]]:
    """Memoize a function of a scene, and update its result when the scene is a changed one.

    `update` gets the result for the scene before, the rows, the scene and other arguments; it returns None where the
    result has to be built anew.
    """

    def decorate(make: Callable[Concatenate[Any, Rest], Table]) -> Callable[Concatenate[Any, Rest], Table]:
        known = Answers[Table]()

        @functools.wraps(make)
        def find(scene: Any, /, *rest: Rest.args, **options: Rest.kwargs) -> Table:
            arguments = (rest, *options.items())
            table = known.of(scene, arguments)
            if table is not MISSING:
                return table
            updated = None
            if len(scene.obstacles) >= MANY and (found := _find_before(scene, known, arguments)) is not None:
                before, table, rows = found
                updated = update(table, rows, scene, *rest, **options)
                earlier = _read_before(before)[0]
                if earlier is not None:
                    known.forget(earlier, arguments)  # tables of two scenes are kept, not of all
            return known.keep(scene, arguments, make(scene, *rest, **options) if updated is None else updated)

        return find

    return decorate


def _read_before(scene: Any) -> tuple[Any, Rows | None]:
    """Return the scene before a change and the rows from there; None where there is none, or it is gone."""
    before, rows = vars(scene).get(_BEFORE, (None, None))
    return before and before(), rows


def _find_before(scene: Any, known: Answers[Table], arguments: object) -> tuple[Any, Table, Rows] | None:
    """Return the last scene before that has a table, the table, and the rows from there to here."""
    rows: Rows | None = None
    while True:
        scene, step = _read_before(scene)
        if scene is None or step is None:
            return None
        rows = step if rows is None else rows.after(step)
        if not rows.are_few:
            return None
        table = known.of(scene, arguments)
        if table is not MISSING:
            return scene, table, rows
