"""`guidefield show`: open a recording in the Rerun viewer, in a window or a web browser of this machine.

Page and file are served on loopback alone, and must be: there is no password.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import threading
import time
import webbrowser
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.console import Console

from guidefield.cli.serving import free_port
from guidefield.viewer import LOOPBACK, CannotShow, has_display, quiet_environment, viewer_command

SERVER_START_TIME_S = 30.0  # time that the web viewer's server has to answer, else the command ends with an error [s]


def show_in_window(recording: Path, err: Console) -> int:
    """Open a recording in the viewer's window, and return its exit code; raises CannotShow without a display."""
    if not has_display():
        raise CannotShow("there is no display for a window: with --web a page for browsers of this machine shows it")
    code = subprocess.call([*viewer_command(), str(recording)], env=quiet_environment())  # noqa: S603 - our interpreter, a file that exists
    if code:
        err.print("If no window can be opened here, --web serves the recording to browsers of this machine.")
    return code


def show_in_browser(recording: Path, out: Console) -> int:
    """Serve a recording and the viewer to browsers of this machine until Ctrl-C, and return the server's exit code.

    Raises CannotShow if the server doesn't answer in time.

    The viewer reads the recording as a file: sent by Rerun's own server it loses its layout.
    """
    with free_port() as page, _serve_file(recording) as file, _start_viewer_server(page, file) as server:
        try:
            if not _await_server(page, server):
                if (code := server.poll()) is None:
                    raise CannotShow(f"the web viewer did not answer within {SERVER_START_TIME_S:g} s")
                return code or 1
            url = f"http://{LOOPBACK}:{page}/?url={quote(file, safe='')}"
            out.print(f"{recording} is at {url}\nCtrl-C ends it.", highlight=False, soft_wrap=True)
            if has_display():
                webbrowser.open(url)
            return server.wait()
        except KeyboardInterrupt:
            return 0


@contextlib.contextmanager
def _start_viewer_server(page: int, file: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run the server of Rerun's web viewer for as long as a block runs; SIGTERM ends it as Ctrl-C does."""
    serve = [*viewer_command(), "--serve-web", "--web-viewer-port", str(page), file]
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with subprocess.Popen(  # noqa: S603 - our interpreter
            serve, env=quiet_environment(), stdout=subprocess.DEVNULL, start_new_session=True
        ) as server:
            try:
                yield server
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(server.pid, signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


@contextlib.contextmanager
def _serve_file(recording: Path) -> Iterator[str]:
    class File(SimpleHTTPRequestHandler):
        def send_head(self) -> Any:
            file = recording.open("rb")
            self.send_response(200)
            self.send_header("Access-Control-Allow-Origin", "*")
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(os.fstat(file.fileno()).st_size))
            self.end_headers()
            return file

        def log_message(self, format: str, *_arguments: object) -> None:  # noqa: A002 - the name of the base class
            """Say nothing."""

    with ThreadingHTTPServer((LOOPBACK, 0), File) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://{LOOPBACK}:{server.server_port}/{quote(recording.name)}"
        finally:
            server.shutdown()


def _await_server(port: int, server: subprocess.Popen[bytes]) -> bool:
    deadline = time.monotonic() + SERVER_START_TIME_S
    while time.monotonic() < deadline and server.poll() is None:
        with socket.socket() as probe:
            probe.settimeout(1.0)
            if probe.connect_ex((LOOPBACK, port)) == 0:
                return True
        time.sleep(0.1)
    return False
