"""Plan with ends at and near the joints' limits, for many robots, and find the exact excess of every motion.

Usage: tools/attack limits [--robots NAME ..] [--chains N] [--seeds N] [--kinds KIND ..]

Positions, velocities, accelerations and jerks of the cubic Hermite curve that a reply describes are held against the
limits, in closed form between the samples too. Without --robots it takes arms of the catalog; --chains draws so many
random robots besides. Exit code 0: no motion exceeds any limit.
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter
from collections.abc import Iterator

from tests.planner.limit_attack import EXACT, SHARES, cases, excess
from tests.robot.random_chains import chain

from guidefield.engine import Engine
from guidefield.errors import GuidefieldError
from guidefield.messages.requests import RobotReference
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.model import RobotModel

ARMS = (
    *("panda", "ur5", "ur5_joint_limited", "ur10_joint_limited", "ur3_joint_limited", "xarm7", "kinova", "z1"),
    *("so100", "so101", "talos_left_arm", "tiago", "baxter", "pr2", "anymal-kinova"),
)


def run(arguments: list[str]) -> int:
    """Plan, and count."""
    parser = argparse.ArgumentParser(prog="tools/attack limits", description=__doc__)
    parser.add_argument("--robots", nargs="*", default=list(ARMS))
    parser.add_argument("--chains", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="seed of the first random robot")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--kinds", nargs="*", choices=list(SHARES), default=list(SHARES))
    options = parser.parse_args(arguments)
    engine, seen, began = Engine(), Counter[str](), time.monotonic()
    durations, planning = 0.0, 0.0
    for name, reference, robot in robots(options):
        for seed in range(options.seeds):
            for case in cases(reference, robot, seed, tuple(options.kinds)):
                reply = engine.answer(case.request)
                seen["plans"] += 1
                seen[reply.status.name] += 1
                if reply.trajectory is None or not reply.certificate.collision_free:
                    if reply.status.name not in ("TIMED_OUT", "PLANNING_FAILED"):
                        print(f"{name} {case.kind} {seed}: {reply.status.name} {reply.status.message}", flush=True)
                    continue
                durations += reply.trajectory.times[-1]
                planning += reply.timing.total - reply.timing.load
                found = excess(reply, case, robot.source.urdf_text)
                seen["motions"] += 1
                seen["beyond a position limit"] += found.position > EXACT
                seen["beyond a limit of rates"] += not found.none and found.position <= EXACT
                if not found.none:
                    print(f"{name} {case.kind} {seed}: {found}", flush=True)
    print(
        f"{dict(seen)}; motions of {durations:.1f} s in all, planned in {planning:.1f} s"
        f", {time.monotonic() - began:.0f} s passed"
    )
    return int(seen["beyond a position limit"] + seen["beyond a limit of rates"] > 0)


def robots(options: argparse.Namespace) -> Iterator[tuple[str, RobotReference, RobotModel]]:
    """Those that are planned for, by name."""
    catalog = Catalog()
    for name in options.robots:
        yield name, name, catalog.load(name)
    for seed in range(options.first, options.first + options.chains):
        urdf = chain(random.Random(seed), 1 + seed % 12)  # noqa: S311 - no secret
        try:
            yield f"chain {seed}", urdf, catalog.load(urdf)
        except GuidefieldError as error:
            print(f"chain {seed}: {error.message}")
