"""Which links of an MJCF MuJoCo tests against each other, and its keyframes, in the words of an SRDF."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from guidefield.messages.requests import Positions
from guidefield.robot.mjcf.compilation import import_mujoco
from guidefield.robot.mjcf.names import named
from guidefield.robot.urdf.srdf import STATES

AT_REFERENCE = "reference"
"""The state in which every joint has its reference value."""


def disabled_pairs(
    model: Any, geoms: Mapping[str, Sequence[int]], rest: np.ndarray, warnings: list[str]
) -> dict[frozenset[str], str]:
    """Pairs of links that aren't tested, with reasons.

    Those that MuJoCo leaves out because of an <exclude>, or because they are parent and child, are left out here. Those
    that only contype and conaffinity keep apart are tested here all the same, except where they touch at rest: masks
    mostly spare a simulation time, and links that meet do so in reality.

    Args:
        model: `mujoco.MjModel`.
        geoms: Indices of the geoms of each link, in their order.
        rest: MuJoCo's configuration, shape (nq,), at rest.
        warnings: Gets a sentence about pairs that MuJoCo doesn't test and we do, or the other way round.
    """
    mujoco = import_mujoco()
    disabled: dict[frozenset[str], str] = {}
    masked: list[tuple[str, str]] = []
    bodies = {link: int(model.geom_bodyid[some[0]]) for link, some in geoms.items()}
    excluded = {frozenset(divmod(int(one), 1 << 16)) for one in model.exclude_signature}
    paired = {
        frozenset((int(model.geom_bodyid[first]), int(model.geom_bodyid[second])))
        for first, second in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    touching = _Touching(model, rest)
    for first, second in combinations(geoms, 2):
        pair, both = frozenset((first, second)), frozenset((bodies[first], bodies[second]))
        if both in paired or model.body_weldid[bodies[first]] == model.body_weldid[bodies[second]]:
            continue
        if both in excluded:
            disabled[pair] = "<exclude>"
        elif _are_parent_and_child(model, bodies[first], bodies[second]):
            disabled[pair] = "adjacent"
        elif not _masks_meet(model, geoms[first], geoms[second]):
            masked.append((first, second))
            if touching(geoms[first], geoms[second]):
                disabled[pair] = "contype and conaffinity, and they touch at rest"
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        warnings.append('the MJCF says <flag contact="disable"/>; contacts count here all the same')
    if masked:
        left = [pair for pair in masked if frozenset(pair) in disabled]
        still = f", except {len(left)} that touch at rest ({_told(left)})" if left else ""
        warnings.append(
            f"for contype and conaffinity MuJoCo never tests {len(masked)} pairs of links ({_told(masked)}); "
            f"they are tested here{still}"
        )
    return disabled


def _told(pairs: Sequence[tuple[str, str]]) -> str:
    more = f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    return " and ".join(pairs[0]) + more


def _are_parent_and_child(model: Any, first: int, second: int) -> bool:
    """Return True if MuJoCo's filter of parents drops a pair of bodies; what is fixed to the world is no parent."""
    if model.opt.disableflags & import_mujoco().mjtDisableBit.mjDSBL_FILTERPARENT:
        return False
    welded, other = int(model.body_weldid[first]), int(model.body_weldid[second])
    if 0 in (welded, other):
        return False
    above = [int(model.body_weldid[model.body_parentid[body]]) for body in (welded, other)]
    return above[0] == other or above[1] == welded


def _masks_meet(model: Any, first: Sequence[int], second: Sequence[int]) -> bool:
    """Return True if some geom of one link may touch some of another, by contype and conaffinity."""
    types, affinities = np.asarray(model.geom_contype), np.asarray(model.geom_conaffinity)
    one, other = np.array(first), np.array(second)
    meet = (types[one][:, None] & affinities[other]) | (types[other] & affinities[one][:, None])
    return bool(np.any(meet))


class _Touching:
    """Tells whether geoms touch at one configuration, by MuJoCo's own distance.

    Args:
        model: `mujoco.MjModel`.
        q: MuJoCo's configuration, shape (nq,).
    """

    def __init__(self, model: Any, q: np.ndarray) -> None:
        self._model, self._mujoco = model, import_mujoco()
        self._data = self._mujoco.MjData(model)
        self._data.qpos[:] = q
        self._mujoco.mj_kinematics(model, self._data)

    def __call__(self, first: Iterable[int], second: Iterable[int]) -> bool:
        second = list(second)
        return any(self._touch(one, other) for one in first for other in second)

    def _touch(self, one: int, other: int) -> bool:
        centres, radii = self._data.geom_xpos, self._model.geom_rbound
        if np.linalg.norm(centres[one] - centres[other]) > radii[one] + radii[other]:
            return False
        apart: float = self._mujoco.mj_geomDistance(self._model, self._data, one, other, 1e-3, None)
        return apart <= 0.0


def keyframe_states(model: Any) -> dict[str, np.ndarray]:
    """MuJoCo's configuration, shape (nq,), of each keyframe by name, `key<index>` without one; then `reference`."""
    states = {name or f"key{index}": np.array(model.key_qpos[index]) for index, name in enumerate(named(model, "key"))}
    return {**states, AT_REFERENCE: np.array(model.qpos0)}


def rest_configuration(model: Any) -> np.ndarray:
    """MuJoCo's configuration, shape (nq,), at rest: the keyframe that an SRDF's states would be chosen by."""
    states = keyframe_states(model)
    return states[next((name for name in STATES if name in states), next(iter(states)))]


def positions(model: Any, joints: Mapping[int, str], q: np.ndarray) -> Positions:
    """Values by joint, as on the wire, of MuJoCo's configuration (nq,): its quaternions begin with w, ours end so."""
    kinds = import_mujoco().mjtJoint
    values: Positions = {}
    for joint, name in joints.items():
        address, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == kinds.mjJNT_FREE:
            x, y, z, w, a, b, c = q[address : address + 7].tolist()
            values[name] = [x, y, z, a, b, c, w]
        elif kind == kinds.mjJNT_BALL:
            w, a, b, c = q[address : address + 4].tolist()
            values[name] = [a, b, c, w]
        else:
            values[name] = float(q[address])
    return values
