"""The numbers of connections, each with what chose it.

Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TreeSettings:
    """Of a search by two trees on the lane kernels, and of the certificate's say about what it finds."""

    # samples of a motion per length in the chart [1/rad or 1/m]: VAMP's resolution, with which its times are compared.
    # A prototype's search at it left 14 of 420 paths of a Panda in contact between samples, which a certificate finds
    resolution: float = 32.0
    attempts: int = 6  # how often the certificate may refuse what was found. Unrecorded
    finer: float = 2.0  # how much finer motions are judged after each refusal. Unrecorded
    most_iterations: int = 100_000_000  # samples that a search draws, which cost next to nothing: for safety
    most_motions: int = 3_000_000  # motions that it judges at most. Unrecorded
    piece: int = 256  # iterations between two checks of the deadline: some milliseconds
    enclosed: int = 20_000  # extensions of roots alone after which it is asked whether these can be left. Unrecorded
    first_capacity: int = 512  # nodes that each tree has room for at first; doubled when it is full. Unrecorded


TREE = TreeSettings()


@dataclass(frozen=True)
class QuickestSettings:
    """Of the choice among several goals by estimated time; `tools/bench motion` measures it."""

    goals: int = 10  # tried at most, the nearest in time first. One tree for all of ten: 4 % slower motions of a Panda
    motions: int = 3000  # that each one's tree judges at most, before all goals are tried together. Unrecorded
    rounds: int = 4  # more rounds of trees at most, where time alone counts
    enough: float = 1.15  # they end when the best score is at most this times the least bound
    # share of a way's length, each joint's by its velocity limit [s/s], in its score, unless time alone counts. On the
    # 420 public problems of a Panda with 0 ways were 1.5 % longer, motions 0.3 % faster, and they kept a millimetre
    # less
    length: float = 0.2
    ways: int = 5  # that are optimised coarsely then at most
    # the same for balanced motions. On 60 problems, 20 each of cages, boxes and tables that are reached under, one way
    # made motions 1.6 % slower, in cages 4 %, and took 15 % less time for the whole plan; five ways gained 0.4 % for 17
    # % more
    few_ways: int = 3


QUICKEST = QuickestSettings()


@dataclass(frozen=True)
class RoundSettings:
    """Of the rounds in which a connection is made shorter; `tools/bench shorter` measures them."""

    motions: int = 2000  # that a round judges at most. Unrecorded
    share: float = 0.5  # rounds end when this share of the time left is over: the rest is for what follows. A choice
    least: float = 1e-3  # by what share a path has to be shorter to be taken. A choice: less is not worth a round
    # a path to a single goal whose score is more than this times the straight one's is a detour, and has so many rounds
    # unless a request says how many. Motions of a Fetch, a Baxter, a Panda take 1.2, 0.7, 0.5 % less, some a third, and
    # whole answers 1.02, 0.99, 0.98 of the time, as shorter ones are optimised sooner; with 8 rounds a Fetch's take 4 %
    # less, and answers 1.11 of the time
    detour: float = 2.0
    of_detour: int = 3  # with 2 a Fetch's motions take 1.1 % less


ROUNDS = RoundSettings()


@dataclass(frozen=True)
class EscapeSettings:
    """Of the question whether a configuration can be left at all."""

    lengths: tuple[float, ...] = (0.3, 0.1, 0.03, 0.01)  # how far the motions go that are tried [rad, or m at size 1]
    directions: int = 1024  # how many of each length, beside those along one coordinate. Unrecorded


ESCAPE = EscapeSettings()


@dataclass(frozen=True)
class ConstrainedSettings:
    """Of trees within path constraints."""

    room: float = 0.6  # configurations are brought to within this share of each limit. Unrecorded
    corrections: int = 15  # Newton steps by which a configuration is brought back. Unrecorded
    stride: float = 0.1  # length of a step of a tree, by the metric [rad]. Unrecorded
    # a step that comes nearer to where it was to go by less than this share of its length ends an extension. Unrecorded
    least_gain: float = 0.2
    farthest: float = 2.0  # so does one that is brought back to this many lengths from where it began. Unrecorded
    piece: int = 32  # iterations between two checks of the deadline: some milliseconds
    most_iterations: int = 10_000_000  # samples at most, no limit but for safety
    shortcuts: int = 60  # detours that are looked at. Unrecorded


CONSTRAINED = ConstrainedSettings()
