"""A chain of links at one configuration: where its joints are, what the field does to its links."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.planner.problem import Problem
from guidefield.potential import Energy
from guidefield.robot.link_chain import Chain


@dataclass(frozen=True, eq=False)
class Strung:
    """A chain at a configuration; the field is asked when it is first needed.

    Attributes:
        problem: Whose robot and field.
        chain: The chain.
        q: Configuration, shape (nq,).
        joints: Places of joints, shape (n + 1, 3) [m, world].
        rotations: Of links, shape (n, 3, 3).
    """

    problem: Problem
    chain: Chain
    q: np.ndarray
    joints: np.ndarray
    rotations: np.ndarray

    def at(self, q: np.ndarray, joints: np.ndarray, rotations: np.ndarray) -> Strung:
        """The same chain elsewhere."""
        return Strung(self.problem, self.chain, q, joints, rotations)

    @property
    def potential(self) -> float:
        """U [m]."""
        return self._energy.potential

    @cached_property
    def forces(self) -> np.ndarray:
        """On links, self-repulsion included, shape (n, 3)."""
        return np.ascontiguousarray(self._wrenches[:, :3])

    @cached_property
    def torques(self) -> np.ndarray:
        """On links, each about the joint before it, in the world's axes, shape (n, 3) [m]."""
        moments: np.ndarray = self._wrenches[:, 3:] - np.cross(self.joints[:-1], self.forces)
        return moments

    def across(self, k: int) -> np.ndarray:
        """Two unit vectors across link k (from 1) and each other, shape (2, 3), carried with the link."""
        link = self.joints[k] - self.joints[k - 1]
        link = link / np.linalg.norm(link)
        own = self.rotations[k - 1].T
        y = own[int(np.argmin(np.abs(own @ link)))]
        y = y - (y @ link) * link
        y /= np.linalg.norm(y)
        return np.array([y, np.cross(link, y)])

    @cached_property
    def _energy(self) -> Energy:
        return self.problem.robot_field.evaluate(self.q)

    @cached_property
    def _wrenches(self) -> np.ndarray:
        """Force, and moment about the world's origin, on each link, shape (n, 6)."""
        wrenches: np.ndarray = self._energy.wrenches[self.chain.joint_of_link]
        return wrenches


def strung(problem: Problem, chain: Chain, q: np.ndarray) -> Strung:
    """A chain at a configuration (nq,)."""
    joints, rotations = chain.places(q)
    return Strung(problem, chain, q, joints, rotations)
