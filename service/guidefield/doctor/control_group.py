"""What the control group of this process, such as its container's, may use: processors and memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")


def processor_quota(root: Path = ROOT, own: Path = OWN) -> float | None:
    """How many processors may be used at once; None without such a limit.

    Args:
        root: Where the groups are.
        own: Says which group is this process's.
    """
    found = []
    for folder in _folders(root, own):
        share, _, period = _read(folder / "cpu.max").partition(" ")
        if share.isdecimal() and period.isdecimal():
            found.append(int(share) / int(period))
        quota, period = _read(folder / "cpu.cfs_quota_us"), _read(folder / "cpu.cfs_period_us")
        if quota.isdecimal() and period.isdecimal():
            found.append(int(quota) / int(period))
    return min(found, default=None)


def memory_limit(root: Path = ROOT, own: Path = OWN) -> int | None:
    """How much memory may be used [bytes]; None without such a limit."""
    found = [_read(folder / name) for folder in _folders(root, own) for name in ("memory.max", "memory.limit_in_bytes")]
    limits = [int(limit) for limit in found if limit.isdecimal() and int(limit) < 1 << 60]
    return min(limits, default=None)


def _folders(root: Path, own: Path) -> Iterator[Path]:
    """The group's folders and those above it, of both versions of control groups."""
    for line in _read(own).splitlines():
        _, names, path = line.split(":", 2)
        above = root if not names else root / names
        group = above / path.lstrip("/")
        while True:
            yield group
            if group in (above, group.parent):
                break
            group = group.parent


def _read(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""
