"""`guidefield batch`: the requests of a file, answered by all cores or by a cluster, with a bar that says how far."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from guidefield.batch.results import RESULTS, Results, items
from guidefield.errors import ERRORS, Status


def run(requests: Path, folder: Path, out: Console, *, workers: int, ray: str | None, recordings: bool) -> int:
    """Answer the requests of a file that aren't answered yet.

    Args:
        requests: One JSON object on each line.
        folder: Where results and recordings go; what is there already is not asked again.
        out: Where the bar goes.
        workers: Processes on this machine.
        ray: Address of a Ray cluster that works instead.
        recordings: Whether plans are recorded.

    Returns:
        Exit code: 0 if all went well, 1 where there was an honest "no", 2 where there was an error.

    Raises:
        MalformedRequest: if the file can't be read.
        CannotWork: if there are no workers, or no such cluster.
    """
    wanted = list(items(requests, folder, recordings=recordings))
    with Results(folder) as results:
        left = [item for item in wanted if not results.has(item)]
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=out) as bar:
            task = bar.add_task("answered", total=len(wanted), completed=len(wanted) - len(left))
            if left:
                if ray is None:
                    from guidefield.batch.local import over_workers

                    outcomes = over_workers(left, workers)
                else:
                    from guidefield.batch.cluster import over_cluster

                    outcomes = over_cluster(left, ray)
                for outcome in outcomes:
                    results.add(outcome)
                    bar.advance(task)
        answered = results.codes()
    names = Counter(Status(code).name if code in set(Status) else str(code) for code in answered)
    crashes = len(wanted) - len(answered)
    if crashes:
        names["CRASH"] = crashes
    out.print(", ".join(f"{count} {name}" for name, count in names.most_common()) or "nothing to do", highlight=False)
    out.print(f"results in {folder / RESULTS}", highlight=False, soft_wrap=True)
    if crashes or any(code in ERRORS for code in answered):
        return 2
    return 0 if all(code == Status.SUCCESS for code in answered) else 1
