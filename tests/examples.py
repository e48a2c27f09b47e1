"""The request files that ship as examples."""

from pathlib import Path

REQUESTS = Path(__file__).resolve().parent.parent / "tools" / "examples" / "requests"


def example(title: str) -> bytes:
    """The request of that title."""
    return (REQUESTS / f"{title}.json").read_bytes()
