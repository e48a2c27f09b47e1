"""The barrier between points of links and other links at one configuration, and the pairs' smallest distances.

Links are coarse things to each other: of a group's points the first few stand for all, as
`planner/optimize/clearance_samples.py` chooses them; the optimizer relies on it, no proof does. The other link's own
motion takes away what the point's adds: only the joints between the two change the distance.
"""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.barrier.sampled_robot import (
    FIRST,
    JOINT,
    PAST,
    PAST_FEW,
    ROBOT,
    SampledRobot,
    Workspace,
    barrier,
    lower_gaps,
    place,
    place_link,
    workspace,
)
from guidefield.kernels.distance.distance import TABLES, DistanceTables, body_distance, bounds_near
from guidefield.kernels.jit.arrays import VECTOR, VECTOR_OUT, Floats, Vector3
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.kinematics.poses import moved_by


@uncounted
def self_barrier(robot: SampledRobot, share: float, work: Workspace) -> float:
    """The barrier of all pairs; adds to the workspace's gradient and Hessian.

    Args:
        work: Scratch, up to date with the configuration.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    links = _placed_links(robot, work)
    for k in range(robot.pairs.shape[0]):
        g, other, reach = robot.pairs[k, 0], robot.pairs[k, 1], robot.pair_ranges[k]
        x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
        dx, dy, dz = x - work.link_centres[other, 0], y - work.link_centres[other, 1], z - work.link_centres[other, 2]
        near = robot.balls[g, 3] + reach
        if dx * dx + dy * dy + dz * dz >= (near + robot.link_balls[other, 3]) ** 2:
            continue
        place_link(robot, other, work)
        if not bounds_near(x, y, z, other, links, near):
            continue
        T = work.joints.poses[robot.groups[g, JOINT]]
        first, last = robot.groups[g, FIRST], robot.groups[g, PAST_FEW]
        work.gaps[first:last] = math.inf
        lower_gaps(T, robot.points, first, last, links, other, work.gaps)
        for i in range(first, last):
            if work.gaps[i] >= reach * reach:
                continue
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz = body_distance(p[0], p[1], p[2], other, links, reach, reach)
            if d < reach:
                value, slope, curvature = barrier(d, reach, robot.size)
                w = share * robot.weights[i] * (robot.groups[g, PAST] - first) / (last - first)
                total += w * value
                _row(robot, robot.groups[g, JOINT], robot.link_joints[other], p, (nx, ny, nz), work)
                _add(w * slope, w * curvature, work)
    return total


@uncounted
def _placed_links(robot: SampledRobot, work: Workspace) -> DistanceTables:
    """The links' bodies where they are in the world; only for what doesn't count references either."""
    t, moved = robot.links, work.links
    return DistanceTables(
        t.kinds, t.obstacles, moved, t.sizes, t.bounds, t.boxes, t.spans, t.anchors, t.nodes, t.surfaces, t.clouds
    )


@uncounted
def _row(robot: SampledRobot, joint: int, other: int, p: Vector3, n: Vector3, work: Workspace) -> None:
    """Gradient of the distance of a point that moves with a joint, along n, to what moves with another."""
    parents, idx_v, S = robot.joints.table.parents, robot.joints.table.idx_v, work.joints.twists
    m = (p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    work.row[:] = 0.0
    for sign, end in ((1.0, joint), (-1.0, other)):
        j = end
        while j > 0:
            for v in range(idx_v[j], idx_v[j] + robot.joints.table.nv[j]):
                linear = S[v, 0] * n[0] + S[v, 1] * n[1] + S[v, 2] * n[2]
                work.row[v] += sign * (linear + S[v, 3] * m[0] + S[v, 4] * m[1] + S[v, 5] * m[2])
            j = parents[j]


@uncounted
def _add(slope: float, curvature: float, work: Workspace) -> None:
    """Add a distance's share to gradient and Hessian; of a long chain only few joints are between two links."""
    first, past = 0, work.row.shape[0]
    while first < past and work.row[first] == 0.0:
        first += 1
    while past > first and work.row[past - 1] == 0.0:
        past -= 1
    row, gradient = work.row[first:past], work.gradient[first:past]
    for r in range(row.shape[0]):
        gradient[r] += slope * row[r]
        share, of_row = curvature * row[r], work.hessian[first + r, first:past]
        for c in range(row.shape[0]):
            of_row[c] += share * row[c]


@uncounted
def _pair_distances(robot: SampledRobot, work: Workspace, distances_out: Floats) -> None:
    """`pair_distances` of a robot that is placed."""
    links = _placed_links(robot, work)
    for k in range(robot.pairs.shape[0]):
        g, other, best = robot.pairs[k, 0], robot.pairs[k, 1], robot.pair_ranges[k]
        T = work.joints.poses[robot.groups[g, JOINT]]
        place_link(robot, other, work)
        distances_out[k] = math.inf
        for i in range(robot.groups[g, FIRST], robot.groups[g, PAST_FEW]):
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d = body_distance(p[0], p[1], p[2], other, links, best, best)[0]
            if d < best:
                best = d
                distances_out[k] = d


@compiled(void(ROBOT, TABLES, VECTOR, VECTOR_OUT))
def pair_distances(robot: SampledRobot, tables: DistanceTables, z: Floats, distances_out: Floats) -> None:
    """Smallest distance from the points to the other link of every pair, as far as it is below the pair's range.

    Args:
        z: Local coordinates, shape (nv,).
        distances_out: Shape (k,) [m]; infinite where nothing is within range.
    """
    work = workspace(robot, tables)
    place(robot, z, work)
    _pair_distances(robot, work, distances_out)
