"""`guidefield replay`: plan a run's request again, and compare the plans bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from guidefield.cli.comparison import largest_step, list_differences, motion_hash
from guidefield.cli.files import require_writable
from guidefield.cli.found_run import Data, Service, StreamName, data_folder, find_run
from guidefield.cli.stream_replaying import record_stream, replay_stream, stream_files
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.stores.robots import RobotStore
from guidefield.stores.scenes import SceneStore

SHOWN_DIGITS = 16
"""Number of digits of a hash to show."""

VERDICT_FIELDS = ("status", "curve", "certificate", "clearance", "self_clearance", "limits")
"""The fields of a certify reply that are the verdict itself."""

out = Console()

Packages = Annotated[
    list[Path] | None, typer.Option(exists=True, file_okay=False, help="Folder of packages with the robot's meshes.")
]


def replay(
    run: StreamName,
    data: Data = None,
    name: Service = "local",
    packages: Packages = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Write a recording of a stream here (.rrd), to be shown.", callback=require_writable),
    ] = None,
) -> None:
    """Plan the request of a run again, or judge its motion; exit code 0 if that is the same to the last bit, else 1.

    A run of another version of guidefield, or of another kind of processor, counts as any other: where its plan
    differs, 1, and it is said which version planned it, and where. 2 where no plan came of it: there is no such run, or
    its request is refused now.

    Robots and scenes that a client stored are looked for in the data folder. A stream is done again, each file that is
    kept of it: whether the same pieces come of it.
    """
    if files := stream_files(run, data_folder(data, name)):
        if record is not None:
            record_stream(files, data_folder(data, name), packages or (), record)
        raise typer.Exit(replay_stream(files, data_folder(data, name), packages or (), _say, _describe_maker))
    if record is not None:
        raise MalformedRequest(f"{run!r} is no stream, and has a recording already", run=run)
    before = find_run(run, data, name)
    folder = data_folder(data, name)
    there = folder.is_dir()  # looking leaves no folder behind
    engine = Engine(
        name,
        scenes=SceneStore(folder / "scenes") if there else None,
        robots=RobotStore(folder / "robots") if there else None,
        packages=tuple(one.resolve() for one in packages or ()),
    )
    try:
        now = engine.answer(msgspec.structs.replace(before.request, run_id=None, recording="off"))
    except GuidefieldError:
        if by_another := describe_version(before.versions):
            _say(f"{run}: {by_another}its request is refused now")
        raise
    if isinstance(before.reply, CertifyReply) and isinstance(now, CertifyReply):
        raise typer.Exit(_compare_verdicts(run, before.reply, now, before.versions))
    assert isinstance(before.reply, PlanReply), "a plan was asked for"
    assert isinstance(now, PlanReply), "a plan was asked for"
    parts = list_differences(before.reply, now)
    if not parts:
        _say(f"{run}: bit-identical: {_summarize(now)}")
        raise typer.Exit(0)
    step = largest_step(before.reply, now)
    by = "" if step is None else f"; waypoints by at most {step:.3g}"
    verdict = describe_processor(before.versions) or "not the same: "
    _say(f"{run}: {verdict}{describe_version(before.versions)}the plan differs in {', '.join(parts)}{by}")
    _say(f"then: {_summarize(before.reply)}\nnow:  {_summarize(now)}\n{describe_versions(before.versions)}")
    raise typer.Exit(1)


def _compare_verdicts(run: str, before: CertifyReply, now: CertifyReply, versions: dict[str, str]) -> int:
    """Print whether two verdicts agree, and return the exit code."""
    parts = [name for name in VERDICT_FIELDS if getattr(before, name) != getattr(now, name)]
    if not parts:
        _say(f"{run}: judged as before: {now.status.name}, {now.status.message}")
        return 0
    _say(f"{run}: {describe_processor(versions) or 'not judged as before: '}it differs in {', '.join(parts)}")
    _say(f"then: {before.status.name}, {before.status.message}\nnow:  {now.status.name}, {now.status.message}")
    return 1


def _describe_maker(before: dict[str, str]) -> str:
    return f"{describe_processor(before) or 'not the same: '}{describe_version(before)}"


def describe_processor(before: dict[str, str]) -> str:
    """Name the processor that made a run, if it is of another kind, which rounds differently; else return "".

    Args:
        before: Versions by package, empty if they weren't recorded.
    """
    from guidefield.versions import PROCESSOR, versions

    then, now = before.get(PROCESSOR), versions()[PROCESSOR]
    if then in (None, now):
        return ""
    family, here = then.partition(" ")[0], now.partition(" ")[0]
    return f"made on {family}, this is {here}: " if family != here else f"made on another kind of {here}: "


def describe_version(before: dict[str, str]) -> str:
    """Name the version of guidefield that planned a run, if it is another one; else return "".

    Args:
        before: Versions by package, empty if they weren't recorded.
    """
    from guidefield.versions import PACKAGE, versions

    then, now = before.get(PACKAGE), versions()[PACKAGE]
    return "" if then in (None, now) else f"planned by {PACKAGE} {then}, this is {now}: "


def describe_versions(before: dict[str, str]) -> str:
    """Say in a sentence which packages beside guidefield had other versions when a run was made.

    Args:
        before: Versions by package, empty if they weren't recorded.
    """
    from guidefield.versions import PACKAGE, versions

    if not before:
        return "the versions that it was made with were not recorded"
    here = versions()
    others = [
        f"{name} {text} (here {here.get(name, 'none')})"
        for name, text in before.items()
        if name != PACKAGE and here.get(name) != text
    ]
    if others:
        return f"it was made with {', '.join(others)}"
    return f"{'otherwise ' if describe_version(before) else ''}it was made with the same versions as are here"


def _summarize(reply: PlanReply) -> str:
    return f"{reply.status.name}, {len(reply.path)} waypoints, sha256 {motion_hash(reply)[:SHOWN_DIGITS]}"


def _say(line: str) -> None:
    out.print(line, highlight=False, soft_wrap=True)
