"""Foreign exceptions as ours: a disk is blamed for nothing but its own faults."""

import errno
import os

import pytest

from guidefield.errors import DiskRefused, GuidefieldError, InternalFailure, WorkerCrashed, convert_exception


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.ENOSPC, DiskRefused),
        (errno.EROFS, DiskRefused),
        (errno.EACCES, DiskRefused),
        (errno.ENOMEM, WorkerCrashed),
        (errno.EMFILE, WorkerCrashed),
        (errno.EPIPE, InternalFailure),
        (errno.ECONNRESET, InternalFailure),
    ],
)
def test_an_error_of_the_system_is_told_as_what_it_is(number: int, kind: type[GuidefieldError]) -> None:
    found = convert_exception(OSError(number, os.strerror(number), "/secret/place"))
    assert type(found) is kind
    assert "/secret" not in found.message or kind is InternalFailure
