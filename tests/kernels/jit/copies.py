"""What a copy of the package needs that compiles kernels."""

from __future__ import annotations

COMPILING = (
    *("__init__", "cache", "compilers", "dependencies", "patched_compiler"),
    *("plain_compiler", "quick_typing", "signatures"),
)
"""Files of the room of kernels, by name."""
