"""`guidefield certify --referee`: the verdict of the second certifier, and the files that it reads."""

from __future__ import annotations

from pathlib import Path

import typer

from guidefield.engine import motion_of
from guidefield.errors import MalformedRequest
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest


def run_referee(request: CertifyRequest, reply: CertifyReply, file: Path | None, *, asked: bool) -> bool:
    """Have the referee certify a motion, and write the file that it reads; return whether all verdicts are free.

    If the certificate is free and a verdict refuses the motion, one of them has a bug, and a line says so.

    Args:
        request: The certify request.
        reply: Its reply.
        file: File for the motion, if any.
        asked: Whether the referee is to certify.
    """
    # Pinocchio and Coal are loaded only here
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
    """Have the referee check a file of proofs, print its verdicts, and return whether all hold.

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
