"""`guidefield certify --referee`: the second certifier's verdict beside the first one's; the files that it reads."""

from __future__ import annotations

from pathlib import Path

import typer

from guidefield.engine import motion_of
from guidefield.errors import MalformedRequest
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest


def run_referee(request: CertifyRequest, reply: CertifyReply, file: Path | None, *, asked: bool) -> bool:
    """Ask the referee about a motion, and write the file that it reads; whether nothing speaks against the motion.

    Where the certificate says that it is free and the referee doesn't, one of them has a bug, and that is told.

    Args:
        request: What the certificate was asked.
        reply: What it said.
        file: Where to write the motion, if anywhere.
        asked: Whether the referee is to judge.
    """
    # Pinocchio and Coal are loaded where somebody asks
    from guidefield import case_file
    from guidefield.referee.judge import judge
    from guidefield.referee.loading import case_of
    from guidefield.referee.printing import lines
    from guidefield.referee.verdict import Answer

    motion = motion_of(request)
    if file is not None:
        case_file.write(file, motion)
    if not asked:
        return True
    verdicts = [judge(case_of(case), seconds=request.allowed_time) for case in case_file.make_cases(motion)]
    for verdict in verdicts:
        typer.echo("\n".join(lines(verdict)))
    free = all(verdict.answer is Answer.FREE for verdict in verdicts)
    told = {Answer.FREE, Answer.UNDECIDED, Answer.NOT_JUDGED}
    if reply.status.name == "SUCCESS" and not all(verdict.answer in told for verdict in verdicts):
        typer.echo("the certificate and the referee contradict each other: please report it with `--case FILE`")
    return free


def replay_proofs(file: Path, seconds: float) -> bool:
    """Have the referee check a file of proofs, and show what it says; whether all hold.

    Raises:
        MalformedRequest: if the file can't be used.
    """
    from guidefield.referee.loading import UnusableFile
    from guidefield.referee.printing import lines
    from guidefield.referee.replay import replay_file
    from guidefield.referee.verdict import Answer

    try:
        verdicts = replay_file(file, seconds)
    except (UnusableFile, OSError) as error:
        raise MalformedRequest(str(error)) from None
    for verdict in verdicts:
        typer.echo("\n".join(lines(verdict, "slabs")))
    return all(verdict.answer is Answer.FREE for verdict in verdicts)
