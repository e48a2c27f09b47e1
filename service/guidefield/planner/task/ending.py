"""How a plan, or a stage of it, ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from guidefield.errors import Status


@dataclass(frozen=True, eq=False)
class Ending:
    """How a plan, or a stage of it, ended.

    Attributes:
        status: Its code.
        message: One sentence that a person can act on.
        details: The values that the message speaks about.
    """

    status: Status
    message: str
    details: dict[str, Any] = field(default_factory=dict)
