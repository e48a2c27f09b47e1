"""The result of one check of this machine."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class State(enum.StrEnum):
    """How something is."""

    FINE = "fine"
    REMARK = "remark"
    """It works, but less well than it could, or not everything does."""
    WRONG = "wrong"
    """A service doesn't start, or doesn't answer."""


@dataclass(frozen=True)
class Finding:
    """What one look found.

    Attributes:
        about: What was looked at.
        state: How it is.
        found: What is there, in a sentence.
        advice: What to do, in a sentence; empty where it is fine.
    """

    about: str
    state: State
    found: str
    advice: str = ""


def fine(about: str, found: str) -> Finding:
    """Nothing is to be done."""
    return Finding(about, State.FINE, found)


def remark(about: str, found: str, advice: str) -> Finding:
    """Something could be better."""
    return Finding(about, State.REMARK, found, advice)


def wrong(about: str, found: str, advice: str) -> Finding:
    """Something has to be done."""
    return Finding(about, State.WRONG, found, advice)
