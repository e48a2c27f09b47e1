"""Nodes whose types are of another version: no message passes between them and this one, so the log names them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from guidefield.endpoint.ros.names import Entity, Kind, Seen

MOST_NAMED = 100
"""How many of them the log names."""
_COUNTERPARTS = {Kind.SERVICE: Kind.CLIENT, Kind.SUBSCRIPTION: Kind.PUBLISHER, Kind.PUBLISHER: Kind.SUBSCRIPTION}


class Strangers:
    """Looks at the tokens of other nodes, and names each kind of stranger once.

    Args:
        ours: What we offer, publish and hear.
        told: Is told of a stranger in one sentence.
    """

    def __init__(self, ours: Iterable[Entity], told: Callable[[str], object]) -> None:
        self._ours = {(_COUNTERPARTS[one.kind].value, one.name): one for one in ours}
        self._told = told
        self._named: set[Seen] = set()

    def look(self, token: str) -> None:
        """Look at a token."""
        seen = Seen.read(token)
        own = None if seen is None else self._ours.get((seen.kind, seen.name))
        if seen is None or own is None or (seen.on_zenoh, seen.type_hash) == (own.on_zenoh, own.type_hash):
            return
        if seen in self._named or len(self._named) >= MOST_NAMED:
            return
        self._named.add(seen)
        self._told(
            f"node {seen.node[:64]!r} has {seen.name} as {seen.on_zenoh[:64]} of {seen.type_hash[:16]}…, here it is"
            f" {own.on_zenoh} of {own.type_hash[:16]}…: they don't meet; `--ros-distro` must be the node's distribution"
        )
