"""Values whose arrays are read-only, so that a value which several parts of the program hold never changes.

tests/test_house.py asks of the dataclasses with arrays in planner/ and prove/ to be `ReadOnly`.
"""

from __future__ import annotations

import numpy as np


def read_only(*arrays: object) -> None:
    """Make arrays read-only, and those in plain tuples; everything else is left as it is."""
    for array in arrays:
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
        elif type(array) is tuple:
            read_only(*array)


class ReadOnly:
    """Base of frozen dataclasses whose arrays are read-only from construction on, also for the code that made them."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            kind = type(value)
            if kind is np.ndarray:  # most values are no arrays, which this check finds fastest
                value.setflags(write=False)
            elif kind is tuple or isinstance(value, np.ndarray):
                read_only(value)
