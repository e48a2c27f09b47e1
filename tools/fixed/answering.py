"""Fixed requests answered through the public door, and what came of each as plain data."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

import guidefield
from fixed.requests import REFEREED, REQUESTS
from guidefield import case_file, engine
from guidefield.referee.case import Finding
from guidefield.referee.judge import judge
from guidefield.referee.loading import case_of

MEASURED = ("timing", "seconds", "run_id", "recording")
"""Fields of a reply that differ every time: clocks, and names of runs."""

PACKAGES = ("guidefield", "numba", "numpy", "pin", "coal")


def answer_all(file: Path, words: list[str]) -> None:
    """Answer the requests whose name has one of the words, tell of each, and write what came of them."""
    answers = {}
    for name, request in REQUESTS.items():
        if not any(word in name for word in words):
            continue
        began = time.perf_counter()
        answers[name] = answer_request(request)
        seconds = time.perf_counter() - began
        print(f"{digest(answers[name])[:16]}  {name}: {outcome(answers[name])}  {seconds:.1f} s", flush=True)
    made_with = {name: version(name) for name in PACKAGES}
    made_with |= {"python": platform.python_version(), "machine": platform.machine()}
    file.write_text(json.dumps({"made_with": made_with, "answers": answers}))
    print(f"{digest(answers)[:16]}  all {len(answers)}, kept in {file}")


def answer_request(request: dict[str, Any]) -> dict[str, Any]:
    """Answer a request; return the reply without measured times, or the error."""
    if request.get("type") == REFEREED:
        return _refereed(request)
    try:
        reply = guidefield.answer(request)
    except guidefield.GuidefieldError as error:
        return {"error": type(error).__name__, "message": str(error)}
    return _unmeasured(msgspec.to_builtins(reply))


def _refereed(request: dict[str, Any]) -> dict[str, Any]:
    """The referee's verdicts about a motion."""
    asked = msgspec.convert({**request, "type": "certify"}, guidefield.CertifyRequest)
    verdicts = [judge(case_of(case)) for case in case_file.make_cases(*_motions_of(asked))]
    return {"verdicts": [{**asdict(verdict), "finding": _plain(verdict.finding)} for verdict in verdicts]}


def _plain(finding: Finding) -> dict[str, Any]:
    return {**asdict(finding), "answer": finding.answer.value}


def digest(value: Any) -> str:
    """SHA-256, in hexadecimal, of plain data; JSON writes a float so that no other one reads the same."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def outcome(answer: dict[str, Any]) -> str:
    """In a few words: how a plan ended, or what was found."""
    if "error" in answer:
        return f"{answer['error']}: {answer['message'][:100]}"
    if "status" in answer:
        made = f"{len(answer['path'])} waypoints" if "path" in answer else answer["certificate"]["reason"]
        return f"{answer['status']['name']}, {made}"
    return ", ".join(sorted(answer)[:4])


def _unmeasured(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _unmeasured(one) for key, one in value.items() if key not in MEASURED}
    if isinstance(value, list | tuple):
        return [_unmeasured(one) for one in value]
    return value


def _motions_of(asked: guidefield.CertifyRequest) -> list[case_file.Motion]:
    """The parts of a motion; a checkout from before contacts were left in parts of their own makes one of it."""
    made: Any = engine
    return made.motions_of(asked) if hasattr(made, "motions_of") else [made.motion_of(asked)]
