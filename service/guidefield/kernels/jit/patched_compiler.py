# ruff: noqa: ARG001  numba calls an overload with arguments that it has no use for
"""Kernels compiled with changes to what is inside numba: nothing becomes machine code twice, or for nobody.

numba by itself makes each function callable by everybody: a part that is compiled into its callers gets machine code
and wrappers of its own, and a kernel is translated and optimised once more into each kernel that calls it. Here a part
stays intermediate code, and a kernel calls another one's machine code by name; its body is known to the caller's
optimiser, so that what is small is still compiled in.

A kernel's machine code is loaded when it is first called, after that of all kernels it calls, and what is only for
compiling isn't looked at then: an answer needs a part of all kernels, and the linker's tables and the types and
functions that numba knows are for callers that are yet to be compiled.

All of it relies on what is inside the versions of numba that `first_start.KNOWN_NUMBA` names. Typing that is
remembered, silence and lazy reading save time alone. Without `_interned` threads make two of one type; and as kernels
call each other by name, a process crashes without `_KernelFlags` (the same name in every process) or another order in
`Kernel.load`. Results have to be those of plain numba, up to rounding.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator
from types import CodeType, ModuleType
from typing import Any

from llvmlite.binding import Linkage, parse_bitcode
from numba import _dynfunc, config
from numba.core import errors, event, ir, sigutils, typeinfer
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.targetconfig import TargetConfig
from numba.core.typed_passes import NativeLowering
from numba.core.types.abstract import _TypeMetaclass
from numba.core.types.functions import BaseFunction
from numba.extending import overload
from numba.np import arrayobj

from guidefield.deadline import waiting_for_kernels
from guidefield.first_start import target_variables
from guidefield.kernels.jit.cache import await_machine_code, use_kernel_folders

_making = threading.RLock()  # a type that is freed here may have others made
_intern = _TypeMetaclass._intern


def intern_one_by_one() -> None:
    """Have it so, in this process."""
    _TypeMetaclass._intern = _interned


def _interned(kind: Any, made: Any) -> Any:
    """The type that is kept of those that are equal to one that was made."""
    with _making:
        return _intern(kind, made)


_defaults: dict[type, dict[str, object]] = {}
_answers: dict[tuple[object, ...], Any] = {}
_ask = BaseFunction.get_call_type


def quicken_typing() -> None:
    """Have numba remember, in this process."""
    TargetConfig.values, TargetConfig.__hash__ = _values, _hash
    BaseFunction.get_call_type = _call_type
    ir.Inst._rec_list_vars = _list_variables


def _values(options: Any) -> dict[str, object]:
    """All of a function's compiler options, in numba's order."""
    kind = type(options)
    if kind not in _defaults:
        _defaults[kind] = {name: option.default for name, option in options.options.items()}
    return {**_defaults[kind], **options._values}


def _hash(options: Any) -> int:
    """The same for all options, as numba's own is: equal ones may be set or left at their defaults."""
    return hash(type(options))


def _call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """The signature of a call.

    Remembered where it follows from the arguments' types: not that of functions that numba compiles for each caller,
    whose key for an implementation is not the function itself.
    """
    if kws:
        return _ask(function, context, args, kws)
    key = (function, context, *args)
    if key in _answers:
        return _answers[key]
    signature = _ask(function, context, args, kws)
    if function._impl_keys.get(signature.args) is function.typing_key:
        _answers[key] = signature
    return signature


_WITHOUT_VARIABLES = frozenset((ir.Loc, str, int, bool, type(None)))


def _list_variables(instruction: Any, value: Any) -> list[Any]:
    """The variables in what an instruction holds, in numba's order; most of it are places and names, passed by here."""
    if isinstance(value, ir.Var):
        return [value]
    if isinstance(value, ir.Inst):
        found: list[Any] = value.list_vars()
        return found
    held = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    found = []
    for one in held:
        kind = type(one)
        if kind is ir.Var:
            found.append(one)
        elif kind not in _WITHOUT_VARIABLES:
            found += _list_variables(instruction, one)
    return found


intern_one_by_one()  # any process with kernels may load them in several threads


class Part(CPUDispatcher):  # type: ignore[misc]  # numba is untyped
    """A function that is compiled for kernels and other parts only."""

    def __call__(self, *arguments: Any, **by_name: Any) -> Any:
        """Run its source, as Python does: there is no machine code that Python could call."""
        return self.py_func(*arguments, **by_name)


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function with machine code, which is loaded, or made, at its first call from Python or by a compiler."""

    def __init__(self, function: Callable[..., Any], signatures: Any, cache: bool, options: dict[str, Any]) -> None:
        super().__init__(
            function, targetoptions={"nopython": True, "boundscheck": None, **options}, pipeline_class=_KernelCompiler
        )
        self.given, self._is_kept, self._is_loaded = signatures, cache, False

    def load(self) -> None:
        """Load its machine code and that of all it calls by name, or make it; at once if that was done before."""
        with waiting_for_kernels(), _LOADING:
            if self._is_loaded:
                return
            self._is_loaded = True
            try:
                for called in _called_by(self.py_func, set[Any]()):
                    called.load()
                if self._is_kept:
                    if not _COMPILES_ONLY:
                        await_machine_code(self.py_func)
                    use_kernel_folders()
                    self._cache = _Kept(self.py_func)
                given = self.given() if callable(self.given) else self.given
                with typeinfer.register_dispatcher(self):
                    for signature in [given] if sigutils.is_signature(given) else given:
                        self.compile(signature)
            except BaseException:
                self._is_loaded = False
                raise
            self.disable_compile()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a call of such types is, for a caller that is compiled."""
        self.load()
        return super().get_call_template(args, kws)

    def add_overload(self, cres: Any) -> None:
        """Keep machine code; what only kernels can call matches no call from Python, which ends in a TypeError."""
        if self.targetoptions.get("no_cpython_wrapper"):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)

    def _compile_for_args(self, *_arguments: Any, **_by_name: Any) -> Any:
        """What to call, where a call from Python found no machine code: this again, once it is loaded."""
        self.load()
        return self


class _Loading(CompileResultCacheImpl):  # type: ignore[misc]
    """Makes a kernel of what was kept of it: what only its callers' compiler wants is read when that asks for it."""

    def reduce(self, cres: Any) -> Any:
        """What is kept of a kernel: of the environments of all that numba compiled into it, those that it uses."""
        *kept, environments = super().reduce(cres)
        code = str(cres.library._final_module)
        return (*kept, tuple(one for one in environments if code.count(one.env_name) > 1))

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """The same as numba's, with the library of a kernel."""
        kept, fndesc, env, signature, objectmode, lifted, annotation, reload_init, referenced = payload
        for initialize in reload_init:
            initialize()
        callable_by = (fndesc.mangled_name, fndesc.llvm_cpython_wrapper_name, fndesc.llvm_cfunc_wrapper_name)
        library = _KernelLibrary.load_kept(target_context.codegen(), kept, callable_by)
        for one in referenced:
            library.codegen.set_env(one.env_name, one)
        return CompileResult(
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=env,
            entry_point=target_context.get_executable(library, fndesc, env),
            fndesc=fndesc,
            type_annotation=annotation,
            signature=signature,
            objectmode=objectmode,
            lifted=lifted,
            typing_error=None,
            call_helper=None,
            metadata=None,
            reload_init=reload_init,
            referenced_envs=referenced,
        )


class _Kept(FunctionCache):  # type: ignore[misc]
    """Where a kernel's machine code is kept; what numba knows is asked for where some has to be made only."""

    _impl_class = _Loading

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What is kept, or None.

        That for the level of processors first, which has been compiled ahead; this process, which may be a user's own,
        compiles for the very processor, as numba does.
        """
        rtsys.initialize(target_context)  # what counts references, which machine code calls by name
        signature, (triple, *own), hashes = self._index_key(sig, target_context.codegen())
        for target in (target_variables().values(), own):
            kept = self._cache_file.load((signature, (triple, *target), hashes))
            if kept is not None:
                return self._impl.rebuild(target_context, kept)
        target_context.refresh()
        return None


_LOADING = threading.RLock()
_COMPILES_ONLY: list[bool] = []  # not empty in a process that waits for no other one's machine code


def _called_by(function: Callable[..., Any], seen: set[Any]) -> Iterator[Kernel]:
    """Kernels that a function may call, itself or through its parts: all that its names may mean."""
    if function in seen:
        return
    seen.add(function)
    names, codes = set[str](), [function.__code__]
    while codes:
        code = codes.pop()
        names.update(code.co_names)
        codes += [one for one in code.co_consts if isinstance(one, CodeType)]
    known = [function.__globals__[name] for name in names if name in function.__globals__]
    known += [
        getattr(one, name) for one in known if isinstance(one, ModuleType) for name in names if hasattr(one, name)
    ]
    known += [cell.cell_contents for cell in function.__closure__ or ()]
    for one in known:
        if isinstance(one, Kernel):
            yield one
        elif isinstance(one, Part):
            yield from _called_by(one.py_func, seen)


def kernel(signatures: Any, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel of one signature or several, or what tells them, with numba's options."""

    def decorate(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:
            return function
        return Kernel(function, signatures, cache, options)

    return decorate


def load(module: ModuleType) -> None:
    """Load or make the machine code of all kernels of a file."""
    for one in vars(module).values():
        if isinstance(one, Kernel) and one.py_func.__module__ == module.__name__:
            one.load()


def part(function: Callable[..., Any], optimized: bool, counting: bool | None, **options: Any) -> Part:
    """Make a part of kernels from its source, as `decorators` says."""
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

    _bitcode: bytes | None = None
    _shared: Any = None

    @property
    def _shared_module(self) -> Any:
        """Bodies to look into; those that were kept are read where they are first asked for."""
        if self._shared is None and self._bitcode is not None:
            self._shared = parse_bitcode(self._bitcode)
        return self._shared

    @_shared_module.setter
    def _shared_module(self, module: Any) -> None:
        self._shared = module

    @classmethod
    def load_kept(cls, codegen: Any, state: Any, callable_by: Iterable[str]) -> _KernelLibrary:
        """Load a kept one: its machine code is ready to be called, by those of some names that it has."""
        name, _, (machine_code, bitcode) = state
        library = cls(codegen, name)
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._bitcode = bitcode
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(name for name in callable_by if name.encode() + b"\0" in machine_code)
        return library

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


def _optimize_defined(library: Any, module: Any) -> None:
    """Optimise the functions of a module one by one, as numba does, without those that are only declared."""
    module.data_layout = library._codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            passes, builder = library._codegen._function_pass_manager()
            passes.run(function, builder)


def _silence() -> None:
    """Have numba tell nobody of its steps, as nobody listens, and not colour what it says of vain attempts."""
    event.start_event = event.end_event = lambda *_arguments, **_by_name: None
    event.trigger_event = lambda *_arguments, **_by_name: contextlib.nullcontext()
    if hasattr(errors, "HighlightColorScheme"):  # where colours are installed
        errors.HighlightColorScheme._markup = lambda _scheme, message, *_others, **_by_name: message


def quicken() -> None:
    """Have numba remember types, and leave both shapes out of what it says of such an assignment, in this process.

    It compiles half of what it knows of strings for them.
    """
    quicken_typing()
    _silence()
    _COMPILES_ONLY.append(True)
    arrayobj.raise_with_shape_context = _refuse_shape
    JITCodeLibrary._optimize_functions = _optimize_defined


_PartCompiler, _OptimizedPartCompiler = _compiler(_PartLowering), _compiler(_OptimizedPartLowering)
_KernelCompiler = _compiler(_KernelLowering)
