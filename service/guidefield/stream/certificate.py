"""The certificate of streams: the door to their judge, with names in place of numbers."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.collide.gjk_simplex import SIMPLEX
from guidefield.kernels.kinematics.group_joints import joint_places
from guidefield.kernels.stream import judge
from guidefield.kernels.stream.judge import DEEPEST, MOST_NODES, JudgedPlaces, JudgedRobot, JudgedShapes, JudgeMemory
from guidefield.stream.commit import Commit, JointBounds


class Judgement(enum.Enum):
    """What the judge says of a commit."""

    FREE = judge.FREE
    LIMITS = judge.LIMITS
    OWN = judge.OWN
    OBSTACLE = judge.OBSTACLE
    UNDECIDED = judge.UNDECIDED


@dataclass(frozen=True)
class Told:
    """A judgement.

    Attributes:
        pair: Index of the pair that isn't told apart, the robot's own first; of a limit, that of the coordinate.
        time: Where it was refused, by the client's clock [s].
    """

    judgement: Judgement
    evaluations: int
    pair: int
    time: float

    @property
    def free(self) -> bool:
        """Whether the commit is proven."""
        return self.judgement is Judgement.FREE


class Judge:
    """A judge with its memory; not for two threads.

    Args:
        tolerances: How far the robot may be off, by coordinate, shape (nv,) [rad or m].
    """

    def __init__(self, robot: JudgedRobot, coordinates: int, bounds: JointBounds, tolerances: np.ndarray) -> None:
        self._robot, self._limits, self._tolerances = robot, bounds.judged, np.array(tolerances, float)
        self._coordinates = coordinates
        self._found = np.zeros(3)
        self._memory = self._of_pairs(64)

    def judge(
        self, commit: Commit, shapes: JudgedShapes, places: JudgedPlaces, most: int, since: float | None = None
    ) -> Told:
        """Judge a commit among obstacles.

        Args:
            since: From when on [s]; None: from its beginning.
        """
        pairs = len(self._robot.own) + len(places.met)
        if pairs > self._memory.pairs.shape[1]:
            self._memory = self._of_pairs(2 * pairs)
        stops = commit.stops - commit.begins
        begun = 0.0 if since is None else min(max(0.0, since - commit.begins), stops)
        verdict = judge.judged(
            self._robot, shapes, places, commit.phases, commit.counts, commit.begins, begun, stops, commit.start,
            self._limits, self._tolerances, most, self._memory, self._found,
        )  # fmt: skip
        looked, pair, time = self._found.tolist()
        return Told(Judgement(verdict), int(looked), int(pair), time)

    def travelled(self, commit: Commit, since: float, until: float, parts: int = 16) -> float:
        """How far any point of the robot comes within a time by a commit, at most [m]; off by its tolerances or not.

        Args:
            since: From when [s].
            until: Until when [s].
        """
        begin = max(0.0, since - commit.begins)
        end = max(begin, until - commit.begins)
        robot, tolerances = self._robot, self._tolerances
        return float(judge.travelled(robot, commit.phases, commit.counts, begin, end, tolerances, parts, self._memory))

    def _of_pairs(self, pairs: int) -> JudgeMemory:
        pairs = max(pairs, len(self._robot.own))
        bodies, places = len(self._robot.carriers), joint_places(self._robot.joints)
        return JudgeMemory(
            places=places,
            joints=places.poses.reshape(-1, 12),
            middle=np.zeros(self._coordinates),
            half=np.zeros(self._coordinates),
            chords=np.zeros(len(places.poses)),
            swept=np.zeros(bodies),
            ways=np.zeros(bodies),
            pairs=np.zeros((DEEPEST + 2, pairs), np.int64),
            counts=np.zeros(DEEPEST + 2, np.int64),
            work=np.zeros(SIMPLEX),
            pose=np.zeros(12),
            stack=np.zeros(MOST_NODES, np.int64),
        )
