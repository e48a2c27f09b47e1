"""numba's types are made by one thread at a time.

numba tells types apart by numbers: of equal ones the first that is made is kept, and looked up for the others. Two
threads that make an equal one at the same moment both find none, and give it two numbers; a kernel that was loaded with
the one refuses arrays of the other, as "No matching definition".
"""

from __future__ import annotations

import threading
from typing import Any

from numba.core.types.abstract import _TypeMetaclass

_making = threading.RLock()  # a type that goes meanwhile may have others made
_intern = _TypeMetaclass._intern


def intern_one_by_one() -> None:
    """Have it so, in this process."""
    _TypeMetaclass._intern = _interned


def _interned(kind: Any, made: Any) -> Any:
    """The type that is kept of those that are equal to one that was made."""
    with _making:
        return _intern(kind, made)
