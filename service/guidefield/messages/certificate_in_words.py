"""What a reply's certificate says, in words for tables and summaries."""

from __future__ import annotations

from guidefield.messages.plan_reply import PlanReply


def place_in_words(row: float, time: float | None) -> str:
    """A place along a motion that was given: its row, and when it has times."""
    return f"row {row:.6g}" if time is None else f"{time:.6g} s (row {row:.6g})"


def certified(reply: PlanReply) -> str:
    """Whether what was judged is free, and what that was: of a plan that failed, the motion as far as it got."""
    covers = reply.certificate.covers
    if covers == "nothing":
        return "nothing was judged"
    judged = f"the {covers}"
    if covers == "path":
        judged = "the start alone" if len(reply.path) == 1 else "the motion as far as it got"
    return f"{'free' if reply.certificate.collision_free else 'not certified'}: {judged}"
