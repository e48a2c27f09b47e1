"""Without changes to what is inside numba kernels return the same, and none of the changes is as much as imported."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from guidefield import first_start, kernels
from guidefield.first_start import KNOWN_NUMBA, PLAIN_VARIABLE, kernel_compiler, kernels_fingerprint, plain_numba
from tests.kernels.jit.plain_slice import results

KERNELS = Path(kernels.__file__).parent
HOUSE = Path(__file__).parents[3]

CHANGES = {"guidefield.kernels.jit.patched_compiler"}  # the files that change numba

MAKERS = {"compiled", "exact_kernel", "vector_kernel", "vector_step", "kernel", "inner_kernel"}  # decorators of kernels

OFFERED = {
    "numba", "numba.extending", "llvmlite.ir",
    "numba.core.cgutils", "numba.core.typing.templates", "numba.core.caching.UserProvidedCacheLocator",
}  # fmt: skip
"""What the others may take from numba: what its documentation writes extensions and locators of caches with."""

LOADED = """
import sys
import guidefield.kernels.simd.vector, guidefield.kernels.jit.arrays, guidefield.kernels.jit.compile_ahead
from guidefield.kernels.jit.decorators import quicken
quicken()
print(*sorted(name for name in sys.modules if name.startswith("guidefield.kernels.")))
"""


def run(*command: str, plain: bool) -> str:
    environment = {**os.environ, PLAIN_VARIABLE: "1" if plain else ""}
    ran = subprocess.run(
        [sys.executable, *command], cwd=HOUSE, env=environment, capture_output=True, text=True, check=True
    )
    return ran.stdout


def test_kernels_return_the_same_up_to_rounding(tmp_path: Path) -> None:
    """Those of each mechanism; whole numbers are the same to the bit."""
    ours, other = results(), tmp_path / "other.npz"
    run("-m", "tests.kernels.jit.plain_slice", str(other), plain=not plain_numba())
    with np.load(other) as theirs:
        assert set(theirs) == set(ours)
        for name, values in ours.items():
            assert np.isfinite(values).all()
            assert np.ptp(values) > 0.0 or values.size == 1
            rounding = {"f": 1e-6 if values.dtype == np.float32 else 1e-13, "i": 0.0}[values.dtype.kind]
            np.testing.assert_allclose(theirs[name], values, rtol=rounding, atol=rounding, err_msg=name)


@pytest.mark.parametrize("plain", [False, True])
def test_the_changes_are_imported_only_where_they_are_wanted(plain: bool) -> None:
    loaded = set(run("-c", LOADED, plain=plain).split())
    assert loaded >= {"guidefield.kernels.simd.vector", "guidefield.kernels.jit.arrays"}
    assert loaded & CHANGES == (set() if plain else CHANGES)


def test_no_other_file_reaches_into_numba() -> None:
    for source in KERNELS.rglob("*.py"):
        if ".".join(source.relative_to(KERNELS.parents[1]).with_suffix("").parts) in CHANGES:
            continue
        for node in ast.walk(ast.parse(source.read_text())):
            for name in _taken(node):
                inside, _, last = name.rpartition(".")
                assert inside in OFFERED or name in OFFERED, f"{source.name}: {name}"
                assert not last.startswith("_"), f"{source.name}: {name}"


def _taken(node: ast.AST) -> list[str]:
    """The full names that an import takes from numba and llvmlite."""
    names = []
    if isinstance(node, ast.ImportFrom) and node.module is not None:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    return [name for name in names if name.partition(".")[0] in ("numba", "llvmlite")]


@pytest.mark.parametrize(
    ("said", "numba", "plain"),
    [
        ("", KNOWN_NUMBA[-1], False),
        ("0", KNOWN_NUMBA[0], False),
        ("1", KNOWN_NUMBA[-1], True),
        ("yes", KNOWN_NUMBA[0], True),
        ("", "1.2", True),
    ],
)
def test_variable_and_version_say_whether_and_keep_machine_code_apart(monkeypatch, said, numba, plain):
    monkeypatch.setattr(first_start, "version", lambda _: numba)
    monkeypatch.setenv(PLAIN_VARIABLE, said)
    assert plain_numba() is plain
    assert kernel_compiler().startswith(f"plain numba {numba} for " if plain else f"numba {numba} for ")
    whole = kernels_fingerprint.__wrapped__()
    monkeypatch.setattr(first_start, "version", lambda _: KNOWN_NUMBA[0])
    monkeypatch.setenv(PLAIN_VARIABLE, "" if plain else "1")
    assert kernels_fingerprint.__wrapped__() != whole


OTHER_VERSION = """
import importlib.metadata as metadata
known = metadata.version
metadata.version = lambda name: "0.99.0" if name == "numba" else known(name)
"""


def test_the_changes_are_left_out_by_themselves_with_another_version() -> None:
    loaded = set(run("-c", OTHER_VERSION + LOADED, plain=False).split())
    assert "guidefield.kernels.jit.decorators" in loaded
    assert not loaded & CHANGES


def test_kernels_stand_below_what_they_use() -> None:
    """Plain numba compiles a kernel where it stands, and knows nothing of the file that stands below it."""
    assert [name for source in KERNELS.rglob("*.py") for name in _using_below(source)] == []


def _using_below(source: Path) -> Iterator[str]:
    body = ast.parse(source.read_text()).body
    functions = {node.name: node for node in body if isinstance(node, ast.FunctionDef)}
    constants = {
        one.id: node
        for node in body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }
    lines = {name: node.lineno for name, node in (functions | constants).items()}
    for name, function in functions.items():
        if not any(ast.unparse(one).partition("(")[0] in MAKERS for one in function.decorator_list):
            continue
        found, waiting = set[str](), [name]
        while waiting:
            part = functions[waiting.pop()]
            names = [one for node in part.body for one in ast.walk(node) if isinstance(one, ast.Name)]
            own = {one.arg for one in part.args.args} | {one.id for one in names if isinstance(one.ctx, ast.Store)}
            used = {one.id for one in names} - own
            waiting += sorted((used & set(functions)) - found)
            found |= used & set(lines)
        yield from (f"{source.name}: {name} uses {one}" for one in sorted(found) if lines[one] > function.lineno)
