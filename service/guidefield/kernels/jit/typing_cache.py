"""numba's inference of types in half the time, by remembering what it works out again and again.

Of an operator numba asks one template after the other for each use, some twenty of them, and each of these compares
all compiler options. What an operator makes of its arguments doesn't change within a process, unless the templates do,
and then numba makes a new type of the operator.
"""

from __future__ import annotations

from typing import Any

from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

_defaults: dict[type, dict[str, object]] = {}
_answers: dict[tuple[object, ...], Any] = {}
_ask = BaseFunction.get_call_type


def quicken_typing() -> None:
    """Have numba remember, in this process."""
    TargetConfig.values, TargetConfig.__hash__ = _values, _hash
    BaseFunction.get_call_type = _call_type


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
