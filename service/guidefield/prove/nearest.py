"""Which obstacles can be the nearest somewhere along a motion: no others have to be measured.

Let c be the distance from some obstacle at some time, and s how far a body moves within a stretch that begins then.
Within it the distance is c + max s at most, so what is nearest is within c + max s + s of its body when it begins.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.prove.curve import Curve
from guidefield.prove.timed_world import TimedWorld
from guidefield.robot.model.spaces import ModelConfiguration

FEW = 64
"""So many obstacles are measured all."""

FIRST_REACH = 0.4
"""Obstacles are looked for within this of the robot first, then within twice as much [m]."""

MEASURED = 2
"""So many pairs, those that boxes tell to be nearest, are measured for a distance that the nearest is within."""


def with_nearest(worlds: TimedWorld, curve: Curve, times: np.ndarray) -> TimedWorld:
    """A robot among those obstacles that can be the nearest along a motion; all that move are among them.

    Args:
        worlds: The robot among all obstacles.
        curve: The motion.
        times: Some times of it, in order, the first and last of all among them, shape (k,) [s].
    """
    world = worlds.moving
    if world.pairs.obstacles <= FEW or not len(world.pairs.moving) or len(times) < 2:
        return worlds
    moving = worlds.movers.indices[np.unique(worlds.mover_of)] if len(worlds.pairs) else np.empty(0, np.int64)
    chosen = np.union1d(moving, _near(worlds, curve, times))
    return worlds if len(chosen) == world.pairs.obstacles else TimedWorld.of(worlds.resting, world.among(chosen))


def _near(worlds: TimedWorld, curve: Curve, times: np.ndarray) -> np.ndarray:
    """Obstacles, as they are placed at first, that can be the nearest, shape (n,)."""
    world, group = worlds.moving, worlds.moving.group
    spans = np.diff(times)
    widths = curve.most(times[:-1], times[1:])[0] * spans[:, None]
    qs = [group.expand_from_chart(z) for z in curve.at(times[:-1])[0]]
    jacobians = np.empty((len(qs), 6, world.model.nv))
    placements, there = np.empty((len(qs), world.model.njoints, 3, 4)), world.joint_placements
    for row, q in enumerate(qs):
        jacobians[row] = pin.computeJointJacobians(world.model, world.data, q).reshape(6, -1)
        placements[row] = there
    centres = world.bodies.centres_in_world(placements)
    travel = world.motion_bound.at(jacobians, centres, widths)[1]
    kept = _kept_at_most(world, qs, centres)
    margins = kept[:, None] + travel.max(axis=1, keepdims=True) + travel
    which, pairs = world.near_pairs.by_place(centres, margins)
    bodies = world.pairs.bodies(pairs)
    near = world.near_pairs.separations(centres, which, pairs) <= margins[which, bodies[:, 0]]
    return np.unique(bodies[near, 1]) - world.pairs.links


def _kept_at_most(world: World, qs: list[ModelConfiguration], centres: np.ndarray) -> np.ndarray:
    """What the distance from the obstacles is at most: that from those that boxes tell to be nearest.

    Args:
        world: Robot and obstacles.
        qs: Configurations of the model, s of them.
        centres: Of the balls about the robot's bodies there, shape (s, r, 3) [m, world].

    Returns:
        Shape (s,) [m]; infinite where there are no pairs with obstacles.
    """
    kept, reach = np.full(len(qs), np.inf), FIRST_REACH
    waiting = np.arange(len(qs) if len(world.pairs) > world.pairs.n_self else 0)
    while len(waiting):
        margins = np.full((len(waiting), world.pairs.links), reach)
        which, pairs = world.near_pairs.by_place(centres[waiting], margins)
        bounds = world.near_pairs.separations(centres[waiting], which, pairs)
        for row in np.unique(which).tolist():
            there = np.flatnonzero(which == row)
            nearest = pairs[there[np.argsort(bounds[there], kind="stable")[:MEASURED]]]
            world.place(qs[waiting[row]])
            kept[waiting[row]] = min(world.distance(pair)[0] for pair in nearest.tolist())
        waiting, reach = np.delete(waiting, np.unique(which)), 2.0 * reach
    return kept
