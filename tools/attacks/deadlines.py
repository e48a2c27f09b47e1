"""Allow little time for the largest requests, written in every form, and find how late a service answers them.

Usage: tools/attack deadlines [--forms json packed] [--kinds boxes points ..] [--times 0.1 0.3 1.0 ..] [--again N]

Each kind has a service of its own, with one worker that has answered a small plan before; there is no network, and
what it takes to keep runs on the disk isn't counted. Nor is what other work of the machine takes: the time for which
no thread of the service ran while a request was read, and the delay of a process that only slept until it was due.
An answer may come 50 ms and 5 % of what it allows after that. Each request is made when it was
never seen, and again at once, while the worker may still prepare for it. Exit code 0: no answer came too late.
"""

from __future__ import annotations

import argparse

from tests.deadline_attack import FORMS, TIMES, late, service, too_late
from tests.deadline_requests import MAKERS


def run(arguments: list[str]) -> int:
    """Ask, and print a row for each way to ask."""
    parser = argparse.ArgumentParser(prog="tools/attack deadlines", description=__doc__)
    parser.add_argument("--forms", nargs="*", choices=list(FORMS), default=list(FORMS))
    parser.add_argument("--kinds", nargs="*", choices=list(MAKERS), default=list(MAKERS))
    parser.add_argument("--times", nargs="*", type=float, default=list(TIMES))
    parser.add_argument("--again", type=int, default=2)
    parser.add_argument("--share", type=float, default=1.0)
    options = parser.parse_args(arguments)
    print(f"{'kind':12s} {'form':7s} {'allowed':>8s} {'late, ms':>28s}  answers", flush=True)
    missed = asked = 0
    for kind in options.kinds:
        with service() as ask:
            for form in options.forms:
                for allowed in options.times:
                    told = late(ask, kind, form, allowed, options.again, options.share)
                    asked += len(told)
                    missed += sum(too_late(seconds, allowed) for seconds, _ in told)
                    shown = " ".join(f"{1e3 * seconds:8.0f}" for seconds, _ in told)
                    ended = ", ".join(name for _, name in told)
                    print(f"{kind:12s} {form:7s} {allowed:8.2f} {shown:>28s}  {ended}", flush=True)
    print(f"{missed} of {asked} answers came too late")
    return int(missed > 0)
