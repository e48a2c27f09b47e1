"""A value's arrays, and those in its tuples, can't be written; others stay what they are."""

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from guidefield.read_only import ReadOnly

Scratch = namedtuple("Scratch", "memory")


@dataclass(frozen=True, eq=False)
class Held(ReadOnly):
    path: np.ndarray
    parts: tuple[np.ndarray, ...]
    none: np.ndarray | None
    scratch: Any


def test_arrays_are_read_only_from_the_first() -> None:
    held = Held(np.zeros(2), (np.zeros(1), np.zeros(3)), None, Scratch(np.zeros(1)))
    for array in (held.path, *held.parts, held.path[1:]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    held.scratch.memory[0] = 1.0
    assert held.path.copy().flags.writeable
