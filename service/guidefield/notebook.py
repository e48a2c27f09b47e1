"""Replies in a Jupyter notebook: a table, and the recording in Rerun's viewer if rerun-notebook is installed.

`SHOWN` names the module that declares each message; others than plans, verdicts, kept runs need a table first.
"""

from __future__ import annotations

import contextlib
import html
from pathlib import Path

from guidefield.messages.replies import AnyRunReply, MotionReply

SHOWN = {"plan_reply": ["PlanReply"], "certify_reply": ["CertifyReply"], "stored": ["RunReply", "CertifyRunReply"]}
"""Messages with a display, by their module in `guidefield.messages`: names, so that none has to be imported."""
VIEWER_HEIGHT = 480  # height of the viewer [pixels]
LEFT_ALIGNED = "style='text-align: left'"  # Jupyter aligns cells at the right, as for numbers


def register_displays() -> None:
    """Have IPython, if this process runs in it, show replies by `display_reply`."""
    from IPython import get_ipython

    shell = get_ipython()
    if shell is None:
        return
    for module, names in SHOWN.items():
        for name in names:
            shell.display_formatter.ipython_display_formatter.for_type_by_name(
                f"guidefield.messages.{module}", name, display_reply
            )


def display_reply(shown: MotionReply | AnyRunReply) -> None:
    """Display the table of a reply or a kept run, and its recording where that is a file of this machine."""
    from IPython.display import HTML, display

    reply = shown if isinstance(shown, MotionReply) else shown.reply
    if reply is None:
        display(repr(shown))
        return
    display(HTML(make_table(reply)))
    recording = Path(reply.recording or "")
    if recording.suffix == ".rrd" and recording.is_file():
        with contextlib.suppress(ImportError):
            from rerun_notebook import Viewer

            viewer = Viewer(width="auto", height=VIEWER_HEIGHT)
            viewer.send_rrd(recording.read_bytes())
            display(viewer)


def make_table(reply: MotionReply) -> str:
    """Make the table of a reply as HTML."""
    from guidefield.cli.tables import motion_rows

    cells = (
        f"<tr><th>{html.escape(name)}</th><td {LEFT_ALIGNED}>{html.escape(text.plain)}</td></tr>"
        for name, text in motion_rows(reply)
    )
    return f"<table class='guidefield'>{''.join(cells)}</table>"
