"""Machine code is loaded at a first call: after that of all kernels that it calls by name, and only what is needed."""

import importlib
import threading

import numpy as np
import pytest

from guidefield.first_start import plain_numba
from guidefield.kernels.jit import patched_compiler
from guidefield.kernels.jit.arrays import SCALAR, VECTOR
from guidefield.kernels.jit.cache import sources
from guidefield.kernels.jit.patched_compiler import Kernel, kernel

pytestmark = pytest.mark.skipif(plain_numba(), reason="numba loads all at once where it is left as it is")


@kernel(SCALAR(VECTOR))
def total(values: np.ndarray) -> float:
    found = 0.0
    for k in range(values.shape[0]):
        found += values[k]
    return found


@kernel(SCALAR(VECTOR))
def twice(values: np.ndarray) -> float:
    return 2.0 * total(values)


def test_a_kernel_is_made_at_its_first_call_with_all_that_it_calls() -> None:
    assert not total.overloads
    with pytest.raises(TypeError, match="No matching definition"):
        twice("five")
    assert len(twice.overloads) == len(total.overloads) == 1
    assert twice(np.arange(4.0)) == 12.0


def test_threads_that_call_at_once_make_one() -> None:
    @kernel(SCALAR(VECTOR))
    def largest(values: np.ndarray) -> float:
        return values.max()

    found: list[float] = []
    threads = [threading.Thread(target=lambda: found.append(largest(np.arange(5.0)))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [4.0] * 4
    assert len(largest.overloads) == 1


def test_what_a_kernel_calls_by_name_is_loaded_before_it() -> None:
    """The names in the bodies that are kept of each, against those that its source leads to."""
    kernels = set[Kernel]()
    for name in sources().names:
        module = importlib.import_module(f"guidefield.kernels.{name}")
        kernels |= {one for one in vars(module).values() if isinstance(one, Kernel)}
    called = {one: set(patched_compiler._called_by(one.py_func, set())) for one in kernels}
    for one in kernels:
        one.load()
    names = {cres.fndesc.mangled_name.encode(): one for one in kernels for cres in one.overloads.values()}
    count = 0
    for one in kernels:
        loaded, waiting = {one}, [one]
        while waiting:
            more = called[waiting.pop()] - loaded
            loaded |= more
            waiting += more
        for cres in one.overloads.values():
            library = cres.library
            body = library._bitcode or library._get_module_for_linking().as_bitcode()
            used = {other for name, other in names.items() if name in body} - {one}
            assert used <= loaded, f"{one.__name__} calls {[o.__name__ for o in used - loaded]}"
            count += len(used)
    assert count > 100
