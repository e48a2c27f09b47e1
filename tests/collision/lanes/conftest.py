"""Memory for tests of what is shared."""

from __future__ import annotations

import pytest

from guidefield import memo
from guidefield.bounded_map import FOUND, BoundedMap


@pytest.fixture
def own_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory for memoized results in which nothing has to make room: what had to is found again, not shared."""
    monkeypatch.setattr(memo, "_FOUND", BoundedMap(FOUND))
