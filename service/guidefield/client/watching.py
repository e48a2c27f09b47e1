"""Subscriptions that last as long as a block runs: the progress of a run, the changes of a scene."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

import msgspec
import zenoh

from guidefield.messages.identities import base_key, shared_key
from guidefield.messages.replies import Progress
from guidefield.messages.scene_changes import SceneChanged

_M = TypeVar("_M", Progress, SceneChanged)


@contextlib.contextmanager
def watching(session: zenoh.Session, user: str, run_id: str, hear: Callable[[Progress], None] | None) -> Iterator[None]:
    """Subscribe a listener to the progress of a run, at any instance; do nothing without a listener.

    Args:
        session: An open session.
        user: Whose run it is.
        run_id: Name of the run; of another user's, which is shared, with the user before it.
        hear: Who hears it, in a thread of the session.
    """
    if hear is None:
        yield
        return

    base = shared_key("*") if ":" in run_id else base_key("*", user)
    with _hearing(session, f"{base}/runs/{run_id}/progress", Progress, hear):
        yield


@contextlib.contextmanager
def watching_scene(
    session: zenoh.Session, user: str, name: str, hear: Callable[[SceneChanged], None]
) -> Iterator[None]:
    """Subscribe a listener to the changes of a stored scene, at any instance.

    Args:
        session: An open session.
        user: Whose scene it is.
        name: Name of the scene.
        hear: Who hears it, in a thread of the session.
    """
    with _hearing(session, f"{base_key('*', user)}/scenes/{name}/changes", SceneChanged, hear):
        yield


@contextlib.contextmanager
def _hearing(session: zenoh.Session, key: str, kind: type[_M], hear: Callable[[_M], None]) -> Iterator[None]:
    def heard(sample: zenoh.Sample) -> None:
        hear(msgspec.json.decode(sample.payload.to_bytes(), type=kind))

    subscriber = session.declare_subscriber(key, heard)
    try:
        yield
    finally:
        subscriber.undeclare()
