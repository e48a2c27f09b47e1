"""Threads that make equal types of numba's at the same moment get the same one."""

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from numba import types
from numba.core.types import abstract
from numba.core.types.abstract import _TypeMetaclass

from guidefield.kernels.jit import patched_compiler


class SlowLookUp(dict[Any, Any]):
    """Who looks up what isn't there is interrupted right after."""

    def get(self, key: Any, default: Any = None) -> Any:
        found = super().get(key, default)
        time.sleep(0.02)
        return found


def made_at_once(length: int) -> list[Any]:
    with ThreadPoolExecutor(4) as threads:
        return list(threads.map(lambda _: types.UniTuple(types.float64, length), range(4)))


def test_equal_types_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert patched_compiler.part, "who has kernels has the change"
    assert _TypeMetaclass._intern is patched_compiler._interned
    monkeypatch.setattr(abstract, "_typecache", SlowLookUp(abstract._typecache))
    made = made_at_once(70_001)
    assert all(one is made[0] for one in made)
