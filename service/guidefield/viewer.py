"""Rerun's viewer in a process of its own: find it, start it if none listens, and send recordings to it.

A viewer started here listens on loopback alone, and must: it asks for no password.
"""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

LOOPBACK = "127.0.0.1"
PORT = 9876  # default port of Rerun's viewer (docs/recordings.md)
START_TIME_S = 30.0  # time that a viewer has to listen [s]
PROBE_TIME_S = 0.5  # time to connect to a viewer, and time that it has to answer [s]
GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])  # HTTP/2's, with no settings
SETTINGS = 4  # the kind of the frame that answers it, in its fourth byte
ADDRESS = "rerun+http://{host}:{port}/proxy"


class CannotShow(RuntimeError):
    """No viewer can be started; says why in one sentence."""


def viewer_command() -> list[str]:
    """Return the command of a viewer that listens on loopback only."""
    return [sys.executable, "-m", "rerun", "--bind", LOOPBACK]


def quiet_environment() -> dict[str, str]:
    """Return this process's environment, in which a viewer says no more than warnings."""
    return {"RUST_LOG": "warn", **os.environ}


def has_display() -> bool:
    """Return whether a window can be opened here."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return sys.platform in {"darwin", "win32"} or bool(named)


def find_viewer(say: Callable[[str], None], port: int = PORT) -> str:
    """Return the address of the viewer on this machine; start one if none listens, as a page if there is no display.

    It goes on after this process.

    Args:
        say: Takes a sentence with the address of its page.
        port: Where it listens.

    Raises:
        CannotShow: if none can be started.
    """
    address = ADDRESS.format(host=LOOPBACK, port=port)
    if is_listening(address):
        return address
    window = has_display()
    with socket.socket() as held:
        held.bind((LOOPBACK, 0))
        page_port = held.getsockname()[1]
    options = ["--expect-data-soon"] if window else ["--serve-web", "--web-viewer-port", str(page_port)]
    started = subprocess.Popen(  # noqa: S603 - our interpreter
        [*viewer_command(), "--port", str(port), *options],
        env=quiet_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # it outlives the reader of ours
        start_new_session=True,
    )
    deadline = time.monotonic() + START_TIME_S
    while not is_listening(address):
        if started.poll() is not None or time.monotonic() > deadline:
            raise CannotShow(f"Rerun's viewer doesn't listen at {address}; `python -m rerun` says why")
        time.sleep(0.1)
    if not window:
        page = f"http://{LOOPBACK}:{page_port}/?url={address.replace('+', '%2B')}"
        say(f"the viewer is at {page}; `kill -- -{started.pid}` ends it")  # the group: Rerun's module starts a process
    return address


def send_recording(recording: bytes, address: str) -> None:
    """Have a running viewer show a recording, the bytes of an `.rrd` file; raises CannotShow if none listens."""
    if not is_listening(address):
        raise CannotShow(f"no viewer listens at {address}")
    host, port = _split(address)
    with tempfile.NamedTemporaryFile(suffix=".rrd") as file:
        file.write(recording)
        file.flush()
        # Where somebody listens already, this command sends the file there.
        command = [sys.executable, "-m", "rerun", "--bind", host, "--port", str(port), file.name]
        subprocess.run(command, env=quiet_environment(), stdout=subprocess.DEVNULL, check=False)  # noqa: S603


def is_listening(address: str) -> bool:
    """Return whether a viewer answers at an address; raises CannotShow if it is none of a viewer.

    Sending to a program that takes connections and never answers, as a viewer that was stopped, would never end.
    """
    try:
        with socket.create_connection(_split(address), PROBE_TIME_S) as probe:
            if not address.startswith("rerun+http://"):
                return True  # TLS: connected is all that is known
            probe.sendall(GREETING)
            return probe.recv(4)[3:] == bytes([SETTINGS])
    except (OSError, OverflowError):
        return False


def _split(address: str) -> tuple[str, int]:
    found = re.fullmatch(r"rerun(?:\+https?)?://(.+):(\d+)/proxy", address)
    if found is None:
        raise CannotShow(
            f"a viewer's address is written like {ADDRESS.format(host=LOOPBACK, port=PORT)}, got {address!r}"
        )
    return found[1].strip("[]"), int(found[2])
