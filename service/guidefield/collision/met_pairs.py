"""Which pairs of bodies stand in the way at several configurations, those met most often first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.collision.world import PairNames, World

MOST_LOOKED_AT = 64
"""Configurations that are looked at: what is met most is known by then."""


@dataclass(frozen=True)
class MetPairs:
    """What was met.

    Attributes:
        looked_at: At how many configurations.
        counts: By pair at how many of them it touches, the most frequent first.
        deepest: Of the first pair the greatest depth [m]; None where it has none.
    """

    looked_at: int
    counts: dict[PairNames, int]
    deepest: float | None

    def told(self) -> str:
        """The pair that is met most, in words; empty if there is none."""
        if not self.counts:
            return ""
        (first, second), count = next(iter(self.counts.items()))
        more = len(self.counts) - 1
        others = f" (and {more} more pair{'s' if more > 1 else ''})" if more else ""
        if self.looked_at == 1:
            return f"{first} and {second}{others}"
        return f"most often {first} and {second}, {count} of {self.looked_at} times{others}"

    def details(self) -> dict[str, object]:
        """The same as values."""
        if not self.counts:
            return {}
        return {
            "pair": list(next(iter(self.counts))),
            "depth": self.deepest,
            "pairs": [list(pair) for pair in self.counts],
            "counts": list(self.counts.values()),
            "looked_at": self.looked_at,
        }


def met_pairs(world: World, qs: Sequence[np.ndarray]) -> MetPairs:
    """The pairs that touch, or of which one is wholly inside the other, at configurations of the group, each (nq,)."""
    counts: Counter[PairNames] = Counter()
    depths: dict[PairNames, float] = {}
    for q in qs[:MOST_LOOKED_AT]:
        contacts = world.contacts(q)
        counts.update({contact.pair for contact in contacts})
        for contact in contacts:
            if contact.depth is not None:
                depths[contact.pair] = max(contact.depth, depths.get(contact.pair, 0.0))
        if not contacts and (inside := world.enclosed(q)) is not None:
            counts[inside] += 1
    ordered = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
    return MetPairs(min(len(qs), MOST_LOOKED_AT), ordered, depths.get(next(iter(ordered), ("", ""))))
