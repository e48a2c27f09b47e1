"""What stands beside our connections, problem by problem: VAMP's rows from the folder, and planners of the same run."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from benchmarks import peers
from benchmarks.problems import Problems, scene_message
from guidefield.collision.world import World
from guidefield.planner.motion.waypoints import polyline
from guidefield.prove.certificate import certify
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build

PEERS_KINEMATICS = 0.30
"""What one forward kinematics of a Panda took where the rows were measured [us]."""

Key = tuple[str, int]
"""Set and index of a problem."""


def kinematics_us(group: PlanningGroup) -> float:
    """What one forward kinematics takes Pinocchio here [us]."""
    data, q = group.model.createData(), pin.neutral(group.model)

    def many() -> None:
        for _ in range(100):
            pin.forwardKinematics(group.model, data, q)

    return 1e4 * _best(many, 0.2)


def beside_vamp(given: Problems, ours: dict[Key, list[float]], kinematics: float) -> None:
    """Print VAMP's rows on our problems, scaled, and our planning and whole call as multiples of them.

    Args:
        given: The problems.
        ours: Planning and whole call of each [us].
        kinematics: Pinocchio's forward kinematics here [us].
    """
    rows = given.peers_rows()
    chosen = [key for key in ours if key in rows and rows[key]["solved"]]
    if not chosen:
        return
    scale = kinematics / PEERS_KINEMATICS
    seen = sum(key in rows for key in ours)
    print(f" VAMP's rows, scaled by {scale:.2f}: solved {len(chosen)} of {seen}")
    found = {key: rows[key] for key in chosen}
    judged = [row["clearance"] for row in found.values() if row.get("clearance") is not None]
    print(f"  paths in collision with the exact meshes: {sum(one <= 0.0 for one in judged)} of {len(judged)} judged")
    calls = {key: row["env_us"] + row["wall_us"] for key, row in found.items()}
    for name, times in (
        ("scene, us", [row["env_us"] for row in found.values()]),
        ("planning, us", [row["plan_us"] for row in found.values()]),
        ("simplification, us", [row["simplify_us"] for row in found.values()]),
        ("whole call with the scene, us", list(calls.values())),
    ):
        print_times(f"  {name}", scale * np.array(times))
    print_times("  length", np.array([row["cost"] for row in found.values()]))
    print(" the same problems, guidefield:")
    print_times("  planning, us", np.array([ours[key][0] for key in chosen]))
    print_times("  whole call, us", np.array([ours[key][1] for key in chosen]))
    _print_multiples("planning", [ours[key][0] / (scale * found[key]["plan_us"]) for key in chosen])
    _print_multiples("whole call", [ours[key][1] / (scale * calls[key]) for key in chosen])


def beside(given: Problems, seconds: float, ours: dict[Key, float]) -> None:
    """Plan the same problems with the planners that are installed, and compare with our whole call [us]."""
    robot, packages = given.folder / "robots" / given.robot / given.robot, given.folder / "robots"
    for name, solve in peers.installed().items():
        answers, hits = [], 0
        for problem in given.problems:
            world = World.build(given.group, build(scene_message(problem)))
            task = peers.Task(robot, packages, world, problem["obstacles"], *given.ends(problem), seconds, 0)
            answers.append(solve(task))
            if answers[-1].path is not None:
                hits += not certify(world, polyline(answers[-1].path)).free
        solved = [answer for answer in answers if answer.path is not None]
        print(f" {name}: solved {len(solved)} of {len(answers)} in {seconds:g} s each; paths not free: {hits}")
        for fault in sorted({answer.fault for answer in answers if answer.fault}):
            print(f"  could not begin: {fault}")
        for step in ("scene", "plan", "simplify"):
            print_times(f"  {step}, us", np.array([getattr(answer, step) for answer in solved]))
        print_times("  length", np.array([np.linalg.norm(np.diff(one.path, axis=0), axis=1).sum() for one in solved]))
        keys = [(problem["set"], problem["index"]) for problem in given.problems]
        both = [(key, one) for key, one in zip(keys, answers, strict=True) if one.path is not None]
        _print_multiples("whole call", [ours[key] / (one.scene + one.plan + one.simplify) for key, one in both])


def print_times(title: str, times: np.ndarray) -> None:
    """Print median, mean and 95th percentile of what is a number."""
    times = times[np.isfinite(times)]
    if len(times):
        print(f"{title}: median {np.median(times):.4g}, mean {times.mean():.4g}, p95 {np.quantile(times, 0.95):.4g}")


def _print_multiples(what: str, ratios: list[float]) -> None:
    """Print our time as a multiple of another's, problem by problem."""
    if not ratios:
        return
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    faster = np.mean(np.array(ratios) <= 1.0)
    print(
        f"  our {what} problem by problem, as a multiple: median {middle:.3g}, a tenth each below {low:.3g} and above"
        f" {high:.3g}; no longer on {100.0 * faster:.0f} %"
    )


def _best(call: Callable[[], object], seconds: float) -> float:
    """Shortest time of a call, of as many as fit into some seconds (at least three) [s]."""
    shortest, spent, count = np.inf, 0.0, 0
    while count < 3 or spent < seconds:
        start = time.perf_counter()
        call()
        elapsed = time.perf_counter() - start
        shortest, spent, count = min(shortest, elapsed), spent + elapsed, count + 1
    return shortest
