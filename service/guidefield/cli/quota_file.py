"""The file in which an operator says what each user may have."""

from __future__ import annotations

from pathlib import Path

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.quotas import Quotas


def read_quotas(file: Path) -> Quotas:
    """The quotas that a JSON file holds.

    Raises:
        MalformedRequest: if it holds none; says where it is wrong and what would be right.
        OSError: if it can't be read.
    """
    try:
        quotas: Quotas = codec.decode(file.read_bytes(), Quotas)
    except MalformedRequest as error:
        raise MalformedRequest(f"{file}: {error.message}", **error.details) from None
    return quotas
