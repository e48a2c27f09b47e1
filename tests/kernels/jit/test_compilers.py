"""Kernels call each other's machine code by name, parts have none, and types are those that numba finds."""

import operator
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba import types
from numba.core.registry import cpu_target
from numba.core.targetconfig import TargetConfig
from numba.core.types import abstract
from numba.core.types.abstract import _TypeMetaclass
from numba.core.types.functions import BaseFunction
from numba.np import arrayobj

from guidefield.kernels.field.field import frozen
from guidefield.kernels.jit import patched_compiler
from guidefield.kernels.jit.arrays import (
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Bits,
    Indices,
    IndicesOut,
    Row,
    RowOut,
    Rows,
    RowsOut,
    Singles,
    array_types,
    numba_type,
)
from guidefield.kernels.jit.decorators import inlined
from guidefield.kernels.jit.patched_compiler import kernel, quicken
from tests.kernels.jit.copies import compiling_package

KERNEL = """
from guidefield.kernels.jit.arrays import VECTOR, VECTOR_OUT
from guidefield.kernels.jit.decorators import compiled
from numba import void
{imported}

@compiled(void(VECTOR, VECTOR_OUT))
def {name}(x, out):
    {body}
"""

RUN = """
import numpy as np
from guidefield.kernels.caller import caller
from guidefield.kernels.callee import callee
out = np.zeros(3)
caller(np.array([1.0, 2.0, 3.0]), out)
print(*out, *(sum(kernel.stats.cache_hits.values()) for kernel in (caller, callee)))
"""


@inlined
def doubled(x: float) -> float:
    return 2.0 * x


@kernel(SCALAR(VECTOR))
def doubled_sum(values: np.ndarray) -> float:
    total = 0.0
    for i in range(values.shape[0]):
        total += doubled(values[i])
    return total


@kernel(SCALAR(VECTOR))
def more(values: np.ndarray) -> float:
    return doubled_sum(values) + 1.0


def copy(values: np.ndarray, out: np.ndarray) -> None:
    out[:] = values


def test_a_kernel_calls_parts_and_kernels() -> None:
    values = np.arange(5.0)
    assert doubled_sum(values) == 20.0
    assert more(values) == 21.0
    (called,), (calling,) = doubled_sum.overloads.values(), more.overloads.values()
    defined = {function.name for function in calling.library.get_defined_functions()}
    assert calling.fndesc.mangled_name in defined
    assert called.fndesc.mangled_name not in defined


def test_arrays_of_other_shapes_are_not_assigned(monkeypatch: pytest.MonkeyPatch) -> None:
    for changed, name in (
        *((arrayobj, "raise_with_shape_context"), (BaseFunction, "get_call_type")),
        *((TargetConfig, "values"), (TargetConfig, "__hash__")),
    ):
        monkeypatch.setattr(changed, name, getattr(changed, name))
    quicken()
    copied = kernel(types.void(VECTOR, VECTOR_OUT))(copy)
    out = np.zeros(3)
    copied(np.arange(3.0), out)
    assert (out == np.arange(3.0)).all()
    with pytest.raises(ValueError, match="another shape"):
        copied(np.arange(4.0), out)


def test_kept_machine_code_finds_what_another_process_compiled(tmp_path: Path) -> None:
    """The name by which a kernel is called doesn't depend on the process, whatever order its sets have."""
    sources = compiling_package(tmp_path / "code")
    loops = "for i in range(x.shape[0]):\n        out[i] = 2.0 * x[i]"
    (sources / "callee.py").write_text(KERNEL.format(imported="", name="callee", body=loops))
    imported = "from guidefield.kernels.callee import callee"
    (sources / "caller.py").write_text(KERNEL.format(imported=imported, name="caller", body="callee(x, out)"))

    def ran(seed: int) -> list[str]:
        environment = {**os.environ, "PYTHONPATH": str(sources.parents[1]), "PYTHONHASHSEED": str(seed)}
        environment["NUMBA_CACHE_DIR"] = str(tmp_path)
        command = [sys.executable, "-c", RUN]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    assert ran(1) == ["2.0", "4.0", "6.0", "0", "0"]
    for seed in (2, 3):
        for folder in (tmp_path / "guidefield/kernels").glob("callee-*"):
            shutil.rmtree(folder)
        assert ran(seed) == ["2.0", "4.0", "6.0", "1", "0"]


@pytest.mark.parametrize("asked", [operator.add, operator.mul, operator.truediv, operator.getitem, operator.lt, abs])
def test_remembered_signatures_are_those_that_numba_finds(asked: object) -> None:
    context = cpu_target.typing_context
    context.refresh()  # else it knows no builtins in a process that has compiled nothing yet
    function = context.resolve_value_type(asked)
    of = {operator.getitem: [(VECTOR, types.int64), (VECTOR, types.slice2_type)], abs: [(SCALAR,), (types.int64,)]}
    both = [(SCALAR, SCALAR), (SCALAR, types.float32), (types.int64, SCALAR), (types.int64, types.int64)]
    for arguments in of.get(asked, both):
        found = [patched_compiler._call_type(function, context, arguments, {}) for _ in range(2)]
        assert found[0] == found[1] == patched_compiler._ask(function, context, arguments, {})


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


class Inner(NamedTuple):
    """All alike, as numba tells such tuples from others."""

    rows: Rows
    more: Rows


class Outer(NamedTuple):
    """Something of each kind."""

    size: int
    share: float
    inner: Inner
    row: Row
    row_out: RowOut
    rows_out: RowsOut
    indices: Indices
    indices_out: IndicesOut
    singles: Singles
    bits: Bits


def test_the_type_is_the_one_that_numba_finds_of_a_value() -> None:
    rows = frozen(np.eye(3))
    value = Outer(
        size=3,
        share=0.5,
        inner=Inner(rows, rows),
        row=frozen(np.ones(2)),
        row_out=np.ones(2),
        rows_out=np.eye(2),
        indices=frozen(np.arange(3)),
        indices_out=np.arange(3),
        singles=frozen(np.ones(2, np.float32)),
        bits=np.zeros(2, np.uint32),
    )
    assert numba_type(Outer) == numba.typeof(value)
    assert numba_type(Inner) == numba.typeof(value.inner)
    assert array_types(Outer) == {
        name: array.dtype for name, array in value._asdict().items() if isinstance(array, np.ndarray)
    }
