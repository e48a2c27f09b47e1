"""`guidefield doctor`: print the findings about this machine, as lines or as JSON."""

from __future__ import annotations

from pathlib import Path

import msgspec
from rich.console import Console
from rich.text import Text

from guidefield.doctor.examination import examination
from guidefield.doctor.finding import Finding, State

COLOURS = {State.FINE: "green", State.REMARK: "yellow", State.WRONG: "red"}


def examine(data: Path, out: Console, *, json: bool) -> int:
    """Print the findings, and return exit code 1 if something is wrong, else 0.

    Args:
        data: Folder of a service's runs, scenes and robots.
        out: The console.
        json: Whether to print a JSON list of findings.
    """
    findings = []
    for finding in examination(data):
        findings.append(finding)
        if not json:
            out.print(_format_finding(finding), soft_wrap=True)
    if json:
        text = msgspec.json.format(msgspec.json.encode(findings), indent=1).decode()
        out.print(text, highlight=False, markup=False, soft_wrap=True)
    return int(any(finding.state is State.WRONG for finding in findings))


def _format_finding(finding: Finding) -> Text:
    advice = f": {finding.advice}" if finding.advice else ""
    return Text.assemble(
        f"{finding.about:<9}", (f"{finding.state:<7}", COLOURS[finding.state]), f"{finding.found}{advice}"
    )
