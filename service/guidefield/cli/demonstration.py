"""`guidefield demo`: the whole journey, from a service's start to recordings that can be looked at."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from guidefield import demo
from guidefield.cli.recording import fetch_recording
from guidefield.cli.serving import service_in_child
from guidefield.cli.tables import plan_table
from guidefield.client import Client
from guidefield.errors import Status


def run(folder: Path, out: Console) -> int:
    """Have a service of our own plan the demonstration's requests; show the replies, keep their recordings.

    Args:
        folder: Where the recordings go.
        out: Where the tables go.

    Returns:
        Exit code: 0 if every request succeeded, else 1.
    """
    folder.mkdir(parents=True, exist_ok=True)
    codes = []
    with (
        service_in_child(lambda line: out.print(line, style="dim", highlight=False)) as service,
        Client.connect(service.endpoint) as client,
    ):
        for name, (title, request) in demo.REQUESTS.items():
            out.print(f"\nplanning: {title} …", style="dim", highlight=False)
            reply = fetch_recording(client, client.plan(request), folder / f"{name}.rrd")
            out.print(plan_table(reply, title))
            codes.append(reply.status.code)
    return 0 if all(code == Status.SUCCESS for code in codes) else 1
