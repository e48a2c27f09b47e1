"""Show a client's runs in a Rerun viewer: their recordings are fetched and sent there in a thread of its own.

What fails is logged, and never reaches the caller.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor

from guidefield.client import questions
from guidefield.client.exchange import Exchange, await_answer
from guidefield.errors import GuidefieldError
from guidefield.messages.replies import MotionReply
from guidefield.viewer import CannotShow, find_viewer, send_recording

_log = logging.getLogger(__name__)


def choose_viewer(show: bool | str) -> str | None:
    """Return the address of the viewer that a caller asks for: this machine's, another one's, or None.

    Raises:
        CannotShow: if there is none on this machine, and none can be started.
    """
    return find_viewer(print) if show is True else show or None


class ShownRuns:
    """Shows one run after the other, in a thread of its own.

    Args:
        exchange: What the recordings are asked over.
        viewer: Address of a running viewer; None: nothing is shown.
    """

    def __init__(self, exchange: Exchange, viewer: str | None) -> None:
        self._exchange, self._viewer = exchange, viewer
        self._showing = ThreadPoolExecutor(1, "guidefield-viewer")

    def add(self, reply: object) -> None:
        """Show the run of a reply, if it is recorded, once those before it are shown."""
        if self._viewer is not None and isinstance(reply, MotionReply) and reply.recording is not None:
            self._showing.submit(self._show, reply.run_id, self._viewer)

    def close(self) -> None:
        """Wait until all runs are shown."""
        self._showing.shutdown()

    def _show(self, run_id: str, viewer: str) -> None:
        try:
            question = questions.recording(run_id)
            send_recording(question.read(await_answer(self._exchange.ask(question))), viewer)
        except (CannotShow, GuidefieldError, OSError) as error:
            _log.warning("run %s isn't shown: %s", run_id, error)
