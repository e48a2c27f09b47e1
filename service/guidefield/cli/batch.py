"""`guidefield batch`: answer the requests of a file on all cores or a cluster, render recordings, show progress.

Exit codes, and files as `guidefield/batch.py` has them, are what scripts read; what is printed may be changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from guidefield.batch import RECORDINGS, RESULTS, Item, ItemAnswer, RequestFile, Results
from guidefield.errors import ERRORS, Status
from guidefield.stores.recordings import Recordings


def run(
    requests: Path, folder: Path, out: Console, *, workers: int, ray: str | None, recordings: bool, render: bool
) -> int:
    """Answer the requests of a file without results in a folder, here or on a Ray cluster; return an exit code.

    It is 0 if all succeeded, 1 if a reply is a failure, 2 if there was an error.

    Raises:
        MalformedRequest: if the file can't be read.
        CannotStart: if there are no workers, or no such cluster.
    """
    with RequestFile(requests) as request_file, Results(folder, request_file) as results:
        wanted, answered = len(request_file), results.codes.total()
        left = (item for item in request_file.items(folder, recordings=recordings) if not results.has(item))
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=out) as bar:
            task = bar.add_task("answered", total=wanted, completed=answered)
            for outcome in _start_answers(left, workers, ray) if answered < wanted else ():
                results.add(outcome)
                bar.advance(task)
            if render:
                _render_owed(folder / RECORDINGS, workers, bar)
        codes = results.codes
    names = {Status(code).name if code in set(Status) else str(code): count for code, count in codes.most_common()}
    if crashes := wanted - codes.total():
        names["CRASH"] = crashes
    out.print(", ".join(f"{count} {name}" for name, count in names.items()) or "nothing to do", highlight=False)
    out.print(f"results in {folder / RESULTS}", highlight=False, soft_wrap=True)
    if crashes or any(code in ERRORS for code in codes):
        return 2
    return 0 if all(code == Status.SUCCESS for code in codes) else 1


def _render_owed(folder: Path, workers: int, bar: Progress) -> None:
    owed = len(Recordings(folder).list_owed())
    if not owed:
        return
    from guidefield.batch import render_over_workers

    task = bar.add_task("recorded", total=owed)
    for fault in render_over_workers(folder, min(workers, owed)):
        if fault is not None:
            bar.console.print(
                f"a recording isn't rendered yet: {fault}; `guidefield runs render {folder.parent}` tries again"
            )
        bar.advance(task)


def _start_answers(items: Iterable[Item], workers: int, ray: str | None) -> Iterator[ItemAnswer]:
    if ray is None:
        from guidefield.batch import answer_over_workers

        return answer_over_workers(items, workers)
    from guidefield.batch import answer_over_cluster

    return answer_over_cluster(items, ray)
