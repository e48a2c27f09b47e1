"""A robot among obstacles as the kernels of the certificate read it."""

from __future__ import annotations

from typing import NamedTuple

from guidefield.kernels.jit.fields import Blocks, Flags, IndexRows, Indices, Row, Rows, numba_type


class CertifiedRobot(NamedTuple):
    """A robot of r bodies, balls about them and what moves them; columns j are those of its model's velocity, n.

    Attributes:
        carriers: The joint that carries each body, shape (r,).
        centres: Centres of the balls about bodies in the frame of that joint, shape (r, 3) [m].
        radii: Their radii, shape (r,) [m].
        part_centres: Centres of balls that together hold a body, in the same frame, shape (r, parts, 3) [m].
        part_radii: Their radii, shape (r,) [m].
        moved_by: Whether joint j moves a body, shape (r, n).
        turns: Whether joint j turns rather than slides, shape (1, n).
        alone: Whether it makes a move of its own, shape (1, n).
        half_widths, together, centred, doubled: As those of `collision.motion_bound.MotionBound`.
        moving: The bodies that are tested against obstacles, ascending, shape (m,).
        own: The robot's own pairs, shape (p, 2).
        apart_from: The first column behind all joints that move both bodies of those, shape (p,).
        corners: Of the cores that hold bodies (`prove.cores`), in the frame of the joint that carries each,
            shape (k, 3) [m].
        corners_from: Where those of each body begin, and the number of all, shape (r + 1,); a body of none has no core.
        disc_axes: Axes of the cores' discs, in the same frame, shape (r, 3).
        discs: Radii of these, 0 for none, shape (r,) [m].
        rounded: Radii of the balls at each point of a core, shape (r,) [m].
        filled: Whether a body's hull fills its core, 1 or 0, shape (r,).
    """

    carriers: Indices
    centres: Rows
    radii: Row
    part_centres: Blocks
    part_radii: Row
    moved_by: Flags
    turns: Flags
    alone: Flags
    half_widths: Rows
    together: Rows
    centred: Rows
    doubled: Row
    moving: Indices
    own: IndexRows
    apart_from: Indices
    corners: Rows
    corners_from: Indices
    disc_axes: Rows
    discs: Row
    rounded: Row
    filled: Indices


class CertifiedObstacles(NamedTuple):
    """Boxes about o obstacles: their own ones, and a tree of boxes along the world's axes.

    Attributes:
        axes: The axes of their own boxes as columns, row by row, shape (o, 9).
        middles: Centres along these, shape (o, 3) [m].
        halves: Half extents, shape (o, 3) [m]; infinite for those without an end.
        cores: Half extents along these of boxes whose corners are those of the cores, shape (o, 3) [m].
        discs: Radii of the cores' discs about the last of these axes, shape (o,) [m].
        rounded: As those of the robot's bodies, shape (o,) [m]; infinite for those without an end.
        filled: As that of the robot's bodies, shape (o,).
        nodes: Lower and upper corners of the tree's boxes, shape (k, 6) [m, world]: those about obstacles, then those
            about every `children` of the level before.
        levels: Where each level begins among them, and the number of all, shape (levels + 1,).
        children: Of how many of its boxes one of the next level is made.
        order: The obstacle of each box of the first level.
        endless: The obstacles that are in no box, shape (e,).
        left_out: Pairs with obstacles that may touch; see `collision.pairs.Pairs`.
    """

    axes: Rows
    middles: Rows
    halves: Rows
    cores: Rows
    discs: Row
    rounded: Row
    filled: Indices
    nodes: Rows
    levels: Indices
    children: int
    order: Indices
    endless: Indices
    left_out: Indices


ROBOT, OBSTACLES = map(numba_type, (CertifiedRobot, CertifiedObstacles))
