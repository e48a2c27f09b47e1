"""The engines of all users: each has its own stores, and all share the caches of robots and scenes.

The caller checks rights to an owner's things (`endpoint/endpoint.py`); to what a request names as ``user:name`` they
are checked here.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from guidefield.bounded_map import ENGINES, BoundedMap
from guidefield.engine import Engine, LocalFiles, SharedCaches
from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages import requests
from guidefield.messages.identities import PLAIN, USERS
from guidefield.messages.replies import Done, RobotsReply, ScenesReply
from guidefield.messages.values import Reply
from guidefield.progress import Watcher
from guidefield.run import LARGEST_RECORDING, whole_recording
from guidefield.stores.by_user import Kind, StoresByUser

if TYPE_CHECKING:
    from guidefield.rendering import Renderings


class Engines:
    """Engines of all users of a service; requests that name local files are refused.

    If stores are only read, by a command that replays earlier runs, no recording is kept, and local files are allowed:
    the person who reads all users' stores owns the machine's files.
    """

    def __init__(
        self, instance: str, stores: StoresByUser, packages: Sequence[Path] = (), viewer: str | None = None
    ) -> None:
        self.stores = stores
        self._instance, self._packages, self._viewer = instance, tuple(packages), viewer
        self._loaded = SharedCaches(self._packages)
        self._engines = BoundedMap[str, Engine](ENGINES)

    def of(self, user: str) -> Engine:
        """Return the engine of a user; raises QuotaExceeded if too many users have something stored already."""
        return self._engines.find(user, lambda: self._make_engine(user), lambda _: 0)

    def answer(
        self,
        asking: str,
        owner: str,
        request: requests.Request,
        *,
        size: int = 0,
        received: float | None = None,
        watcher: Watcher | None = None,
    ) -> Reply:
        """Answer one request about things of an owner; the caller has checked the right to them.

        Raises GuidefieldError as `Engine.answer`; QuotaExceeded if the owner has no space for it.
        """
        if isinstance(request, requests.StoreScene | requests.ChangeScene | requests.StoreRobot):
            self.stores.require_room(owner, size)
        reply = self.of(owner).answer(request, received=received or time.monotonic(), watcher=watcher)
        if isinstance(request, requests.DeleteScene):
            self.stores.of(owner).shared.remove("scenes", request.name)
        elif isinstance(request, requests.DeleteRobot):
            self.stores.of(owner).shared.remove("robots", request.name)
        return self._add_shared(asking, owner, reply)

    def render(self, owner: str, run_id: str) -> None:
        """Render the recording of a run from its log, if it has only a log; raises OSError if the disk refuses."""
        self._renderings.render(self.stores.of(owner).recordings, run_id)

    def recording(self, owner: str, run_id: str) -> bytes:
        """Return the self-contained recording of a run, rendered if it has only a log.

        Raises UnknownObject if there is none, or it is damaged; raises OSError if the disk refuses.
        """
        self.render(owner, run_id)
        return whole_recording(self.stores.of(owner).recordings, run_id)

    @functools.cached_property
    def _renderings(self) -> Renderings:
        from guidefield.rendering import Renderings

        return Renderings({self._loaded.packages: self._loaded.catalog}, self._loaded.scenes)

    def share(self, owner: str, kind: Kind, name: str, *, shared: bool) -> Done:
        """Share a thing with all users, or end that; raises GuidefieldError if there is no such thing."""
        stores = self.stores.of(owner)
        if kind == "runs":
            stores.runs.share(name, shared=shared)
        else:
            if kind == "scenes":
                stores.scenes.read(name)
            elif stores.robots.find(name) is None:
                self.of(owner).answer(requests.ReadRobot(name))
            (stores.shared.add if shared else stores.shared.remove)(kind, name)
        if shared:
            return Done(done=f"{kind.removesuffix('s')} {name!r} can be read by everybody, as {f'{owner}:{name}'!r}")
        return Done(done=f"{kind.removesuffix('s')} {name!r} can be read by nobody else any more")

    def stream_recording(self, owner: str, name: str) -> bytes:
        """Make the recording of a stored stream from all files of its journal.

        Raises UnknownObject if there is none of that name, or no update yet, or it is damaged or too large;
        GuidefieldError if its robot or scene is refused now; OSError if the disk refuses.
        """
        from guidefield.stream import journal
        from guidefield.stream.shown import render

        files = journal.kept_files(self.stores.streams_of(owner), name)
        try:
            recording = render(files, self.of(owner).stream)
        except MalformedRequest as error:
            raise UnknownObject(f"stream {name!r} has no recording: {error.message}", stream=name) from None
        if len(recording) > LARGEST_RECORDING:
            raise UnknownObject(
                f"the recording of stream {name!r} has {len(recording)} bytes, at most {LARGEST_RECORDING} are sent: at"
                f" the service `guidefield runs export {name} stream.rrd` writes it, `guidefield replay FILE --record"
                " stream.rrd` that of a single file of it",
                stream=name,
            )
        return recording

    def _make_engine(self, user: str) -> Engine:
        stores = self.stores.of(user)
        return Engine(
            self._instance if user == PLAIN else f"{self._instance}/{USERS}/{user}",
            runs=stores.runs,
            recordings=None if self.stores.reading else stores.recordings,
            scenes=stores.scenes,
            robots=stores.robots,
            local_files=LocalFiles.ALLOWED if self.stores.reading else LocalFiles.REFUSED,
            packages=self._packages,
            loaded=self._loaded,
            lend=partial(self._lend, user),
            viewer=self._viewer,
        )

    def _lend(self, asking: str, kind: Kind, owner: str, name: str) -> Engine:
        self.stores.require_right(asking, owner, kind, name, read_only=True)
        return self.of(owner)

    def _add_shared(self, asking: str, owner: str, reply: Reply) -> Reply:
        if isinstance(reply, ScenesReply):
            return ScenesReply(scenes=[*reply.scenes, *self._list_shared_names(asking, owner, "scenes")])
        if isinstance(reply, RobotsReply):
            names = self._list_shared_names(asking, owner, "robots")
            return RobotsReply(robots=[*reply.robots, *self.of(owner).summaries(names)])
        return reply

    def _list_shared_names(self, asking: str, owner: str, kind: Kind) -> list[str]:
        found = []
        for other in self._list_other_users(owner):
            stores = self.stores.of(other)
            names = stores.scenes.stored() if kind == "scenes" else stores.robots.names()
            found += [f"{other}:{name}" for name in names if self.stores.may_read(asking, other, kind, name)]
        return found

    def _list_other_users(self, owner: str) -> list[str]:
        return [user for user in (PLAIN, *self.stores.users()) if user != owner]
