"""A list of runs, read page by page."""

from __future__ import annotations

import msgspec

from guidefield.client.questions import Question, runs
from guidefield.messages.replies import RunsReply
from guidefield.messages.store_requests import LARGEST_PAGE, ReadRuns


class RunPages:
    """Pages of a list of runs, joined to one.

    Args:
        filters: The filters, and where the list begins; their `limit` plays no part.
        limit: The largest number of runs; None: no limit.
    """

    def __init__(self, filters: ReadRuns, limit: int | None) -> None:
        self._filters, self._rest = filters, limit
        self.joined: RunsReply | None = None

    def ask(self) -> Question[RunsReply] | None:
        """Return the question for the next page; None: the list is complete."""
        if self.joined is not None and (self._rest == 0 or self.joined.next is None):
            return None
        limit = LARGEST_PAGE if self._rest is None else min(self._rest, LARGEST_PAGE)
        after = self._filters.after if self.joined is None else self.joined.next
        return runs(msgspec.structs.replace(self._filters, limit=limit, after=after))

    def add(self, page: RunsReply) -> None:
        """Take the next page."""
        before = [] if self.joined is None else self.joined.runs
        self.joined = msgspec.structs.replace(page, runs=[*before, *page.runs])
        self._rest = None if self._rest is None else self._rest - len(page.runs)

    @property
    def reply(self) -> RunsReply:
        """All pages as one reply."""
        assert self.joined is not None, "at least one page is asked for"
        return self.joined
