"""Explain an unreachable pose: too far away, reachable in another orientation only, or beyond limits of joints only."""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.tip_chain import ChainToTip, unlimited
from guidefield.robot.ik.pose_search import EXACT, SEARCH, PoseSearch, PoseTarget
from guidefield.robot.model.spaces import ChartPoint


class Cause(enum.Enum):
    """What stands in the way of a pose; the values are the words of replies."""

    OUT_OF_REACH = "out of reach"
    """The chain to the tip is too short; the one cause that is certain."""
    POSITION = "position"
    """The place."""
    ORIENTATION = "orientation"
    """The orientation there."""


@dataclass(frozen=True, eq=False)
class Unreached:
    """The cause why a pose is not reached, the same as a sentence, and the values in this."""

    cause: Cause
    reason: str
    values: dict[str, Any]

    @property
    def details(self) -> dict[str, Any]:
        """Cause and values, for a reply."""
        return {"cause": self.cause.value, **self.values}


def out_of_reach(chain: ChainToTip, target: PoseTarget) -> Unreached | None:
    """Prove that a pose is farther away than the chain is long; None where it isn't."""
    begin = target.placement.actInv(chain.table.first[3::4])
    beyond = np.maximum(np.abs(begin) - target.position_tolerance, 0.0)
    short = math.sqrt(float(beyond @ beyond)) - chain.reach - EXACT
    if short <= 0.0:
        return None
    sentence = (
        f"out of reach: at least {int(1000.0 * short)} mm short, as the chain to the tip is {chain.reach:.3g} m long"
    )
    return Unreached(Cause.OUT_OF_REACH, sentence, {"short_by": short, "reach": chain.reach})


def why_unreached(
    group: PlanningGroup, target: PoseTarget, search: PoseSearch, tried: str, rng: np.random.Generator
) -> Unreached:
    """Find what stands in the way of a pose that no descent reached; by descents, so nothing of it is proved.

    Args:
        group: The joints that may move.
        target: The pose.
        search: The search that failed.
        tried: How much was tried, for the sentence.
        rng: Where random starts come from.
    """
    place = dataclasses.replace(target, orientation_tolerance=np.full(3, np.inf))
    descent = PoseSearch(group, place, search.base)
    values: dict[str, Any]
    if not len(descent.descend(descent.drawn(SEARCH.why_starts, rng))):
        off = float(np.linalg.norm(descent.closest[:3]))
        sentence = f"the tip gets no nearer to the place than {1000.0 * off:.3g} mm, in any orientation"
        cause, values = Cause.POSITION, {"position_off": off}
    elif np.isfinite(target.orientation_tolerance).any():
        off = _turn_needed(group, target, search.base, rng)
        sentence = (
            f"the place is in reach, but not in this orientation: the nearest is about {off:.2g} rad"
            f" ({np.degrees(off):.0f} degrees) off"
        )
        cause, values = Cause.ORIENTATION, {"orientation_off": off}
    else:
        position, rotation = (float(np.linalg.norm(part)) for part in (search.closest[:3], search.closest[3:]))
        sentence = f"the closest is {position:.2g} m and {rotation:.2g} rad off"
        cause, values = Cause.POSITION, {"position_off": position}
    beyond = _limit_in_the_way(group, target, search.base, rng)
    if beyond is not None:
        sentence += f"; without limits it is reached: {beyond[0]}"
        values.update(beyond[1])
    return Unreached(cause, f"no solution from {tried}: {sentence}", values)


def _turn_needed(group: PlanningGroup, target: PoseTarget, base: ChartPoint, rng: np.random.Generator) -> float:
    """How much more the tip has to be allowed to turn about each axis until descents reach the place [rad]."""
    low, high = 0.0, np.pi
    for _ in range(SEARCH.why_halvings):
        middle = 0.5 * (low + high)
        allowed = dataclasses.replace(target, orientation_tolerance=target.orientation_tolerance + middle)
        descent = PoseSearch(group, allowed, base)
        if len(descent.descend(descent.drawn(SEARCH.why_starts, rng))):
            high = middle
        else:
            low = middle
    return high


def _limit_in_the_way(
    group: PlanningGroup, target: PoseTarget, base: ChartPoint, rng: np.random.Generator
) -> tuple[str, dict[str, Any]] | None:
    """Find the limit in the way, in the solution for which limits have to give way least; a sentence, its values."""
    bounded = PoseSearch(group, target, base)
    free = PoseSearch(group, target, base, unlimited(bounded.chain))
    points = bounded.near_base(free.descend(bounded.drawn(SEARCH.why_starts, rng)))
    if not len(points):
        return None
    excess = np.maximum(np.maximum(group.lower - points, points - group.upper), 0.0)
    z, excess = points[best := int(np.argmin(excess.max(axis=1)))], excess[best]
    worst = int(np.argmax(excess))
    if excess[worst] <= 0.0:
        return None
    joint = next(joint for joint in group.joints if joint.idx_v <= worst < joint.idx_v + joint.nv)
    limits = [float(group.lower[worst]), float(group.upper[worst])]
    sentence = f"{joint.name} would have to be at {z[worst]:.4g}, its limits are [{limits[0]:.4g}, {limits[1]:.4g}]"
    return sentence, {"joint": joint.name, "value": float(z[worst]), "limits": limits}
