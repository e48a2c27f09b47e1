"""The allowed collision matrix: which pairs of links and objects may touch.

An entry of two names counts before the defaults of either; a default counts for a name against all others, and where
both have one, both must allow. Pairs of links that the robot's own description leaves out are left out in any case.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType
from typing import Any

from guidefield.endpoint.ros.refusals import Refused

MOST_NAMES = 2_000
"""Names in a matrix."""


@dataclass(frozen=True)
class Matrix:
    """Who may touch whom."""

    pairs: MappingProxyType[frozenset[str], bool]
    defaults: MappingProxyType[str, bool]

    @classmethod
    def read(cls, message: Any, where: str) -> Matrix:
        """The matrix of a moveit_msgs/AllowedCollisionMatrix; raises Refused if it isn't square."""
        names, rows = message.entry_names, message.entry_values
        alone, allowed = message.default_entry_names, message.default_entry_values
        if len(names) > MOST_NAMES:
            raise Refused(f"`{where}.entry_names` has {len(names)} names, at most {MOST_NAMES} are read")
        if len(rows) != len(names):
            raise Refused(f"`{where}.entry_values` must have a row for each name, {len(names)}, got {len(rows)}")
        for index, row in enumerate(rows):
            if len(row.enabled) != len(names):
                many = f"{len(names)} values, got {len(row.enabled)}"
                raise Refused(f"`{where}.entry_values[{index}].enabled` must have {many}")
        if len(alone) != len(allowed):
            raise Refused(f"`{where}.default_entry_values` must have {len(alone)} values, got {len(allowed)}")
        pairs = {
            frozenset((names[i], names[j])): bool(rows[i].enabled[j]) for i, j in combinations(range(len(names)), 2)
        }
        defaults = dict(zip(alone, map(bool, allowed), strict=True))
        return cls(MappingProxyType(pairs), MappingProxyType(defaults))

    def allows(self, first: str, second: str) -> bool:
        """Whether two may touch."""
        pair = self.pairs.get(frozenset((first, second)))
        if pair is not None:
            return pair
        known = [self.defaults[name] for name in (first, second) if name in self.defaults]
        return bool(known) and all(known)

    def allowed(self, names: Collection[str]) -> list[tuple[str, str]]:
        """The pairs of some names that may touch."""
        if not any(self.defaults.values()):
            there = set(names)
            some = (tuple(sorted(pair)) for pair, may in self.pairs.items() if may and pair <= there)
            return sorted((pair[0], pair[1]) for pair in some if len(pair) == 2)
        return [pair for pair in combinations(sorted(names), 2) if self.allows(*pair)]

    def message(self, names: Iterable[str], left_out: Collection[frozenset[str]]) -> dict[str, Any]:
        """Return the moveit_msgs/AllowedCollisionMatrix of some names; pairs that are left out may touch, too."""
        order = sorted(names)
        rows = [[frozenset((one, other)) in left_out or self.allows(one, other) for other in order] for one in order]
        return {
            "entry_names": order,
            "entry_values": [{"enabled": row} for row in rows],
            "default_entry_names": list(self.defaults),
            "default_entry_values": list(self.defaults.values()),
        }


NOBODY = Matrix(MappingProxyType({}), MappingProxyType({}))
"""Nobody may touch anybody."""
