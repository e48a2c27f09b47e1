"""Contacts: which pairs of bodies touch at a configuration, how deep, and which do most often at several."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.collision.enclosure import enclosed
from guidefield.collision.pairs import PairNames
from guidefield.collision.world import World
from guidefield.robot.model.spaces import ModelConfiguration


@dataclass(frozen=True)
class Contact:
    """Names of a link and a link or obstacle that touch; how far they must part to be free [m], None of a surface."""

    pair: tuple[str, str]
    depth: float | None


def contacts_at(world: World, q: ModelConfiguration) -> list[Contact]:
    """Every pair that touches at a configuration of the model, shape (model.nq,), in the order of the world's pairs.

    What a held object touches wherever the planned joints are comes first.
    """
    return [*(Contact(*one) for one in world.held_contacts), *contacts_among(world, world.near(q))]


def contacts_among(world: World, pairs: list[int]) -> list[Contact]:
    """Those of some pairs that touch where the robot is placed."""
    return [Contact(world.pair_names(pair), depth_of(world, pair)) for pair in pairs if world.touches(pair)]


def depth_of(world: World, pair: int) -> float | None:
    """How deep the bodies of a pair that touches are in each other where the robot is placed; see `Contact.depth`."""
    if not world.is_signed(pair):
        return None
    return max(0.0, -world.distance(pair)[0])


MOST_LOOKED_AT = 16  # configurations that are examined: what is met most is known by then


@dataclass(frozen=True)
class BlockingPairs:
    """How often pairs touched at the configurations looked at, the most frequent first."""

    looked_at: int
    counts: dict[PairNames, int]
    deepest: float | None  # of the first pair the greatest depth [m]; None where it has none
    # the most that one of them keeps from the obstacles, if they were to keep something [m]
    clearest: float | None = None

    def describe(self) -> str:
        """The pair that is met most, in words; empty if there is none."""
        if not self.counts:
            return ""
        (first, second), count = next(iter(self.counts.items()))
        more = len(self.counts) - 1
        others = f" (and {more} more pair{'s' if more > 1 else ''})" if more else ""
        often = "" if self.looked_at == 1 else "most often "
        times = "" if self.looked_at == 1 else f", {count} of {self.looked_at} times"
        kept = "" if self.clearest is None else f"; the most that one keeps is {1000.0 * self.clearest:.1f} mm"
        return f"{often}{first} and {second}{times}{others}{kept}"

    def details(self) -> dict[str, object]:
        """The same as values."""
        if not self.counts:
            return {}
        details: dict[str, object] = {
            "pair": list(next(iter(self.counts))),
            "depth": self.deepest,
            "pairs": [list(pair) for pair in self.counts],
            "counts": list(self.counts.values()),
            "looked_at": self.looked_at,
        }
        return details if self.clearest is None else {**details, "clearance": self.clearest}


class Touching(NamedTuple):
    """Where the robot's bodies stand at a configuration (r, 3, 4) [m], and the pairs that touch."""

    bodies: np.ndarray
    pairs: list[int]


def find_touching_each(world: World, qs: Sequence[ModelConfiguration]) -> tuple[list[Touching], list[bool]]:
    """What touches at the configurations that `blocking_pairs` looks at, and at which of all something does."""
    near, looked_at = world.near_each(qs), len(qs[:MOST_LOOKED_AT])
    met = _find_touching(world, qs[:looked_at], near)
    touches = [bool(one.pairs or world.held_contacts) for one in met]
    return met, touches + world.in_collision_each(qs[looked_at:], near[looked_at:])


def _find_touching(world: World, qs: Sequence[ModelConfiguration], near: Sequence[list[int]]) -> list[Touching]:
    found = []
    for q, pairs in zip(qs, near, strict=False):
        world.place(q)
        found.append(Touching(world.body_placements.copy(), [pair for pair in pairs if world.touches(pair)]))
    return found


def blocking_pairs(
    world: World, qs: Sequence[ModelConfiguration], clearance: float = 0.0, met: Sequence[Touching] | None = None
) -> BlockingPairs:
    """The pairs that touch, or of which one is wholly inside the other, at configurations of the group's model.

    Where nothing touches, the nearest pair counts that doesn't keep a clearance from obstacles [m]. What touches at the
    first of them may be known from `find_touching_each`.
    """
    clearest: float | None = None
    counts: Counter[PairNames] = Counter()
    names: dict[int, PairNames] = {}
    touching: defaultdict[PairNames, list[tuple[np.ndarray, int]]] = defaultdict(list)
    looked_at = qs[:MOST_LOOKED_AT]
    for q, (there, pairs) in zip(
        looked_at, met or _find_touching(world, looked_at, world.near_each(looked_at)), strict=True
    ):
        names |= {pair: world.pair_names(pair) for pair in pairs if pair not in names}
        counts.update({names[pair] for pair in pairs} | {one.pair for one in world.held_contacts})
        for pair in pairs:
            touching[names[pair]].append((there, pair))
        if pairs or world.held_contacts:
            continue
        if (inside := enclosed(world, q)) is not None:
            counts[inside] += 1
        elif clearance > 0.0 and (near := clearance_at(world, q)).obstacle_pair is not None:
            counts[near.obstacle_pair] += 1
            clearest = max(near.obstacle_distance, clearest or 0.0)
    ordered = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
    first = next(iter(ordered), ("", ""))
    held = {one.pair: one.depth for one in world.held_contacts}
    return BlockingPairs(len(looked_at), ordered, held.get(first) or _deepest(world, touching[first]), clearest)


def _deepest(world: World, touching: Sequence[tuple[np.ndarray, int]]) -> float | None:
    """The greatest depth of pairs that touch where the robot's bodies stand so, (r, 3, 4) [m]; None if none has one."""
    depths = []
    for placements, pair in touching:
        world.put_bodies(placements)
        depths.append(depth_of(world, pair))
    return max((depth for depth in depths if depth is not None), default=None)
