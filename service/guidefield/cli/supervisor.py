"""What the supervisor that started this process is told: how the start goes, when it is ready, that it ends.

The protocol is systemd's (sd_notify(3)): a datagram to the socket that the variable NOTIFY_SOCKET names.
"""

from __future__ import annotations

import os
import socket

READY, STOPPING = "ready", "stopping"
"""How the sentences begin by which a service says that it takes requests, and that it ends."""


def tell_supervisor(sentence: str) -> None:
    """Tell a sentence, if there is anybody to be told; a supervisor that doesn't listen keeps nobody waiting.

    Args:
        sentence: As `endpoint.service.serve` announces it.
    """
    where = os.environ.get("NOTIFY_SOCKET", "")
    if not where:
        return
    told = [f"STATUS={' '.join(sentence.split())}"]
    if sentence.startswith(READY):
        told.append("READY=1")
    if sentence.startswith(STOPPING):
        told.append("STOPPING=1")
    address = f"\0{where[1:]}" if where.startswith("@") else where
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        try:
            sender.sendto("\n".join(told).encode(), address)
        except OSError:
            return  # it has gone, or reads nothing; the service is none the worse
