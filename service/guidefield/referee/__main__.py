"""Judge a motion in a file, or check its proof: ``python -m guidefield.referee FILE``.

The exit code is 0 where it is free, 1 where it isn't or isn't proved, 2 where the file can't be used.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from guidefield.referee.case import Answer, lines
from guidefield.referee.judge import judge
from guidefield.referee.loading import UnusableFile, load
from guidefield.referee.proof import is_proof
from guidefield.referee.replay import replay_file


def main() -> int:
    """Judge the cases or proofs of the file that is named, print the verdicts, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m guidefield.referee", description="Judge a motion in a file.")
    parser.add_argument("file", type=Path, help="cases, or a proof, as `guidefield certify` writes them")
    parser.add_argument("--extra", type=float, default=0.0, help="distance to keep beyond what is required [m]")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="time to judge in")
    asked = parser.parse_args()
    try:
        if is_proof(asked.file):
            verdicts, rests_on = replay_file(asked.file, asked.seconds), "slabs"
        else:
            cases, rests_on = load(asked.file), "distances"
            verdicts = [judge(case, asked.extra, seconds=asked.seconds) for case in cases]
    except (UnusableFile, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for verdict in verdicts:
        sys.stdout.write("\n".join(lines(verdict, rests_on)) + "\n")
    return 0 if all(verdict.answer is Answer.FREE for verdict in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
