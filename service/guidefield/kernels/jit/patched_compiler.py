# ruff: noqa: ARG001  numba calls an overload with arguments that it has no use for
"""Kernels compiled with changes to what is inside numba: nothing becomes machine code twice, or for nobody.

numba by itself makes each function callable by everybody: a part that is compiled into its callers gets machine code
and wrappers of its own, and a kernel is translated and optimised once more into each kernel that calls it. Here a part
stays intermediate code, and a kernel calls another one's machine code by name; its body is known to the caller's
optimiser, so that what is small is still compiled in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite.binding import Linkage
from numba import _dynfunc, njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.extending import overload
from numba.np import arrayobj

from guidefield.kernels.jit.typing_cache import quicken_typing


class Part(CPUDispatcher):  # type: ignore[misc]  # numba is untyped
    """A function that is compiled for kernels and other parts only."""

    def __call__(self, *arguments: Any, **by_name: Any) -> Any:
        """Run its source, as Python does: there is no machine code that Python could call."""
        return self.py_func(*arguments, **by_name)


def kernel(signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel of one signature or several, with numba's options."""
    decorator: Callable[[Callable[..., Any]], Any] = njit(signature, pipeline_class=_KernelCompiler, **options)
    return decorator


def part(function: Callable[..., Any], optimized: bool, counting: bool | None, **options: Any) -> Part:
    """A part of kernels from its source, with numba's options: compiled into each caller.

    Args:
        function: Its source.
        optimized: Whether it is optimised before that, too.
        counting: Whether it counts references; None: as its caller does.
        options: numba's.
    """
    options = {"nopython": True, "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **options}
    if counting is not None:
        options["_nrt"] = counting
    return Part(function, targetoptions=options, pipeline_class=_OptimizedPartCompiler if optimized else _PartCompiler)


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code that is never translated by itself, and optimised where it is compiled into."""

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=self._codegen._opt_level, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _OptimizedPartLibrary(_PartLibrary):
    """The same, optimised by itself as well."""

    def _optimize_final_module(self) -> None:
        JITCodeLibrary._optimize_final_module(self)


class _KernelFlags(Flags):  # type: ignore[misc]
    """Compiler options that don't change the name of a kernel's machine code.

    Callers in the cache know it by its name: it has to be the same whichever process compiles it, and numba's name has
    a set of options in it, in any order.
    """

    def get_mangle_string(self) -> str:
        return "kernel"


class _KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Machine code that other kernels call by its name."""

    _shared_module: Any

    def _get_module_for_linking(self) -> Any:
        """What is linked into callers: bodies to look into, without machine code of their own."""
        self._ensure_finalized()
        if self._shared_module is None:
            module: Any = self._final_module.clone()
            for function in module.functions:
                if not function.is_declaration and function.linkage == Linkage.external:
                    function.linkage = Linkage.available_externally
            self._shared_module = module
        return self._shared_module


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):  # type: ignore[misc]
    _name = "guidefield_part_lowering"
    library: type[_PartLibrary] = _PartLibrary

    def run_pass(self, state: Any) -> bool:
        library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library, state.flags.no_compile = library, True
        super().run_pass(state)
        lowered = state["cr"]
        name = lowered.fndesc.qualname
        key = _dynfunc.make_function(lowered.fndesc.lookup_module(), name, name, 0, lowered.env, (library,))
        state.targetctx.insert_user_function(key, lowered.fndesc, [library])
        state.reload_init.extend(library._reload_init)
        state["cr"] = lowered._replace(cfunc=key)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _OptimizedPartLowering(_PartLowering):
    _name = "guidefield_optimized_part_lowering"
    library = _OptimizedPartLibrary


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):  # type: ignore[misc]
    _name = "guidefield_kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        state.func_id.unique_id, state.flags = 0, _KernelFlags(state.flags)
        return bool(super().run_pass(state))


def _compiler(lowering: type[NativeLowering]) -> type[Compiler]:
    """Numba's compiler with another last step."""

    class _Compiler(Compiler):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
            pipeline.passes = [(lowering if one is NativeLowering else one, why) for one, why in pipeline.passes]
            pipeline._finalized = False
            pipeline.finalize()
            return [pipeline]

    return _Compiler


def _refuse_shape(source: Any, target: Any) -> None:
    """What an assignment between arrays of different shapes does; kernels only."""


@overload(_refuse_shape)
def _refused_shape(source: Any, target: Any) -> Any:
    def refuse(source: Any, target: Any) -> None:
        raise ValueError("an array can't be assigned to one of another shape")

    return refuse


def quicken() -> None:
    """Have numba remember types, and leave both shapes out of what it says of such an assignment, in this process.

    It compiles half of what it knows of strings for them.
    """
    quicken_typing()
    arrayobj.raise_with_shape_context = _refuse_shape


_PartCompiler, _OptimizedPartCompiler = _compiler(_PartLowering), _compiler(_OptimizedPartLowering)
_KernelCompiler = _compiler(_KernelLowering)
