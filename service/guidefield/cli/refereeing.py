"""`guidefield certify --referee`: the second certifier's verdict beside the first one's; the files that it reads."""

from __future__ import annotations

from pathlib import Path

import typer

from guidefield.engine import motion_of
from guidefield.errors import MalformedRequest
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest


def refereed(request: CertifyRequest, reply: CertifyReply, file: Path | None, *, asked: bool) -> bool:
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
    verdicts = [judge(case_of(case), seconds=request.allowed_time) for case in case_file.cases(motion)]
    for verdict in verdicts:
        typer.echo("\n".join(lines(verdict)))
    free = all(verdict.answer is Answer.FREE for verdict in verdicts)
    told = {Answer.FREE, Answer.UNDECIDED, Answer.NOT_JUDGED}
    if reply.status.name == "SUCCESS" and not all(verdict.answer in told for verdict in verdicts):
        typer.echo("the certificate and the referee contradict each other: please report it with `--case FILE`")
    return free


def write_proof_of(request: CertifyRequest, reply: CertifyReply, file: Path) -> None:
    """Write the proof that a motion is free, where the certificate says that it is.

    Args:
        request: What the certificate was asked.
        reply: What it said.
        file: Where to write the proof.

    Raises:
        MalformedRequest: if the motion begins by leaving a contact.
    """
    from guidefield.proof_file import write_proof

    if reply.status.name != "SUCCESS":
        typer.echo(f"there is no proof of a motion that isn't free: {file.name} isn't written")
        return
    motion = motion_of(request)
    if motion.touching:
        raise MalformedRequest("a motion that begins by leaving a contact has no proof")
    write_proof(file, motion)


def replayed(file: Path) -> bool:
    """Have the referee check a proof, and show what it says; whether the proof holds.

    Raises:
        MalformedRequest: if the file can't be used.
    """
    from guidefield.referee.loading import UnusableFile, case_of
    from guidefield.referee.printing import lines
    from guidefield.referee.proof import load_proof
    from guidefield.referee.replay import replay
    from guidefield.referee.verdict import Answer

    try:
        told, proof = load_proof(file)
        verdict = replay(case_of(told), proof)
    except (UnusableFile, OSError) as error:
        raise MalformedRequest(str(error)) from None
    typer.echo("\n".join(lines(verdict, "slabs")))
    return verdict.answer is Answer.FREE
