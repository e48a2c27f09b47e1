"""Judge a motion in a file: ``python -m guidefield.referee FILE``; the exit code is 0 where it is free, else 1 or 2."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from guidefield.referee.judge import judge
from guidefield.referee.loading import UnusableFile, load
from guidefield.referee.printing import lines
from guidefield.referee.verdict import Answer


def main() -> int:
    """Read the file that is named, judge it and print what was found."""
    parser = argparse.ArgumentParser(prog="python -m guidefield.referee", description="Judge a motion in a file.")
    parser.add_argument("file", type=Path, help="cases, as `guidefield certify --case` writes them")
    parser.add_argument("--extra", type=float, default=0.0, help="distance to keep beyond what is required [m]")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="time to judge in")
    asked = parser.parse_args()
    try:
        cases = load(asked.file)
    except (UnusableFile, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    verdicts = [judge(case, asked.extra, seconds=asked.seconds) for case in cases]
    for verdict in verdicts:
        sys.stdout.write("\n".join(lines(verdict)) + "\n")
    return 0 if all(verdict.answer is Answer.FREE for verdict in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
