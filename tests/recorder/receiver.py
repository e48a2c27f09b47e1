"""A viewer without a window: what streams into it is written to a file, and read back."""

import contextlib
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rerun.chunk import Chunk, RrdReader

from guidefield.cli.serving import free_port
from guidefield.viewer import ADDRESS, LOOPBACK, is_listening, quiet_environment, viewer_command

TIME_S = 120.0  # time for a viewer to start or to end, or for something to arrive [s]


@dataclass(frozen=True)
class Receiver:
    """A viewer without a window: its address, and the file that it writes."""

    address: str
    file: Path

    def chunks(self) -> dict[str, list[Chunk]]:
        """All that came by now, by the ids of recordings; layouts are left out."""
        if not self.file.exists():
            return {}
        reader = RrdReader(str(self.file))
        return {one.recording_id: list(reader.stream(store=one).to_chunks()) for one in reader.recordings()}

    def has_layout(self) -> bool:
        return bool(RrdReader(str(self.file)).blueprints())


@contextlib.contextmanager
def receiver(folder: Path) -> Iterator[Receiver]:
    """Run such a viewer; its file is whole once the block has ended."""
    file = folder / "received.rrd"
    with free_port() as port:
        command = [*viewer_command(), "--port", str(port), "--save", str(file)]
        with subprocess.Popen(command, env=quiet_environment(), stdout=subprocess.DEVNULL) as child:
            address = ADDRESS.format(host=LOOPBACK, port=port)
            deadline = time.monotonic() + TIME_S
            while not is_listening(address):
                assert child.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
            try:
                yield Receiver(address, file)
            finally:
                child.send_signal(signal.SIGINT)
                child.wait(TIME_S)
