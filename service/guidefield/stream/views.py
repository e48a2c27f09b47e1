"""Read-only views of arrays for kernels; the owner of an array goes on writing it."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

Named = TypeVar("Named", bound=tuple[Any, ...])


def read_only_views(named: Named, *written: str) -> Named:
    """A named tuple with a read-only view in place of each array."""
    fields = named._fields  # type: ignore[attr-defined]  # a named tuple has them
    pairs = zip(fields, named, strict=True)
    views = [_view(one) if isinstance(one, np.ndarray) and name not in written else one for name, one in pairs]
    return type(named)(*views)


def _view(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.setflags(write=False)
    return view
