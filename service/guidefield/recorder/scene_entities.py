"""Draw the scene in a recording: obstacles, guide planes, poses to reach, and the place of a failure."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages import scene as messages
from guidefield.messages.replies import MotionReply
from guidefield.messages.requests import PlanRequest, PoseGoal
from guidefield.recorder import bodies, surface
from guidefield.recorder.chunks import Color, entity, make_columns, path_times, rgba, still, timed
from guidefield.recorder.surface import Surface
from guidefield.scene.obstacle import Obstacle

GOLDEN_ANGLE = 0.381966
"""Share of the colour circle between one obstacle's hue and the next: never close to those before it."""
FAILURE_COLOR = (255, 220, 215, 255)
GOAL_COLOR = (120, 220, 160, 255)
FLOOR_COLOR = (118, 122, 130, 255)
PLANE_HUES = (0.52, 0.60)  # hues of the first and the last guide plane
PANE_ALPHA = 40  # opacity of guide planes, of 255
SEE_THROUGH_ALPHA = 70  # opacity of an obstacle that stands between the eye and the path, of 255


def obstacles(
    all_of_them: Sequence[Obstacle], see_through: Collection[str], at_fault: Collection[str]
) -> Iterator[Chunk]:
    """Draw obstacles as solid bodies: an entity for all primitives of a kind, one for all polygons, one for each other.

    Obstacles that move, are at fault (red) or hide the path from the first view (translucent) have entities of their
    own, `/obstacles/single/<name>`, too; clouds are drawn as points.
    """
    alike: dict[type, list[tuple[Obstacle, Color]]] = {}
    walls: list[tuple[Obstacle, Color]] = []
    for number, obstacle in enumerate(all_of_them):
        color = bodies.FAULT_COLOR if obstacle.name in at_fault else obstacle_color(obstacle, number)
        if {obstacle.name}.isdisjoint({*see_through, *at_fault}) and obstacle.motion is None:
            kind = next((kind for kind in PRIMITIVES if obstacle.placed and isinstance(obstacle.shape, kind)), None)
            if kind is not None:
                alike.setdefault(kind, []).append((obstacle, color))
                continue
            if isinstance(obstacle.message, messages.Polygon):
                walls.append((obstacle, color))
                continue
        if obstacle.cloud is not None:
            points = rr.Points3D(obstacle.cloud.points, radii=[obstacle.cloud.radius], colors=[color])
            yield still(single(obstacle.name), points)
            continue
        drawn = surface.shade(obstacle.vertices, obstacle.triangles)
        alpha = SEE_THROUGH_ALPHA if obstacle.name in see_through else color[3]
        yield still(single(obstacle.name), bodies.mesh(drawn, (*color[:3], alpha)))
    for kind, members in alike.items():
        path, batch = PRIMITIVES[kind]
        shapes, placements = [one.shape for one, _ in members], [pin.SE3ToXYZQUAT(one.placement) for one, _ in members]
        drawn_as = batch(shapes, np.array(placements))
        names = {"labels": [one.name for one, _ in members], "show_labels": False, "fill_mode": "solid"}
        yield still(f"/obstacles/{path}", drawn_as(colors=[color for _, color in members], **names))
    if walls:
        yield _walls(walls)


def _walls(members: Sequence[tuple[Obstacle, Color]]) -> Chunk:
    """Draw polygons as one mesh, lit from both sides, with their names in the order of its triangles."""
    parts = []
    for one, color in members:
        corners = one.vertices[one.triangles].reshape(-1, 3).astype(np.float32)
        spanned = np.cross(corners[1::3] - corners[::3], corners[2::3] - corners[::3])
        normals = np.repeat(spanned / np.linalg.norm(spanned, axis=1, keepdims=True), 3, axis=0).astype(np.float32)
        parts.append(Surface(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3), normals).colored(color))
    return still(
        "/obstacles/walls", bodies.mesh(surface.join(parts)), rr.AnyValues(names=[one.name for one, _ in members])
    )


def single(name: str) -> str:
    """Return the entity of an obstacle that has its own."""
    return entity("obstacles", "single", name)


def moving(all_of_them: Sequence[Obstacle], times: np.ndarray) -> Iterator[Chunk]:
    """Draw moving obstacles, relative to where they are drawn at first, at times (n,) [s] of the trajectory."""
    for one in all_of_them:
        if one.motion is None:
            continue
        moved = [pin.SE3ToXYZQUAT(one.placement_at(time) * one.placement.inverse()) for time in times.tolist()]
        columns = make_columns(rr.Transform3D, translation=np.array(moved)[:, :3], quaternion=np.array(moved)[:, 3:])
        yield timed(single(one.name), [path_times(times)], columns)


def obstacle_color(obstacle: Obstacle, number: int) -> Color:
    """Return the colour of a scene's obstacle by its number (RGBA): muted, and unlike its neighbours'."""
    if isinstance(obstacle.message, messages.HalfSpace):
        return FLOOR_COLOR
    lightness, saturation = (0.60, 0.30) if number % 2 else (0.70, 0.28)
    return rgba((0.08 + GOLDEN_ANGLE * number) % 1.0, lightness, saturation, 255)


def guide_planes(planes: Sequence[messages.GuidePlane], size: float) -> Iterator[Chunk]:
    """Draw guide planes as translucent panes with outlines and names, all of them one entity."""
    if not planes:
        return
    shares = np.linspace(0.0, 1.0, len(planes)) if len(planes) > 1 else [0.0]
    hues = [PLANE_HUES[0] + share * (PLANE_HUES[1] - PLANE_HUES[0]) for share in shares]
    corners = [np.array(plane.vertices, float) for plane in planes]
    counts = [len(one) for one in corners]
    firsts = np.cumsum([0, *counts[:-1]])
    fans = [first + np.array([[0, i, i + 1] for i in range(1, n - 1)]) for first, n in zip(firsts, counts, strict=True)]
    pane = rr.Mesh3D(
        vertex_positions=np.concatenate(corners),
        triangle_indices=np.concatenate(fans),
        vertex_colors=[
            rgba(hue, 0.55, 0.9, 255) for hue, count in zip(hues, counts, strict=True) for _ in range(count)
        ],
        albedo_factor=(255, 255, 255, PANE_ALPHA),
    )
    outlines = [np.vstack([one, one[:1]]) for one in corners]
    edges = rr.LineStrips3D(outlines, colors=[rgba(hue, 0.6, 0.95, 255) for hue in hues], radii=[0.0025 * size])
    # not always the same corner: planes often stand close behind one another
    named = [one[number % len(one)] for number, one in enumerate(corners)]
    labels = rr.Points3D(
        named,
        labels=[plane.name for plane in planes],
        colors=[rgba(hue, 0.78, 0.95, 255) for hue in hues],
        show_labels=True,
    )
    yield still("/guide_planes", pane, edges, labels)


def goals(request: PlanRequest, size: float) -> Iterator[Chunk]:
    """Draw the poses that the tip is to reach, if goals are poses: their axes and their names."""
    named = [("goal", request.goal), *((f"steps[{index}]", step.goal) for index, step in enumerate(request.steps))]
    for name, asked in named:
        if isinstance(asked, PoseGoal):
            yield _goal(name, asked, size)


def _goal(called: str, asked: PoseGoal, size: float) -> Chunk:
    at = rr.Transform3D(translation=asked.position, quaternion=rr.Quaternion(xyzw=asked.quaternion_xyzw))
    name = rr.Points3D([[0.0, 0.0, 0.0]], labels=[called], colors=[GOAL_COLOR], radii=[0.008 * size], show_labels=True)
    path = "/path/goal" if called == "goal" else entity("path", "goals", called)
    return still(path, at, rr.TransformAxes3D(0.1 * size), name)


def failure(reply: MotionReply, tip: np.ndarray, size: float) -> Chunk:
    """Draw the place of a failure: a mark at the tip (3,) [m, world], and its reason in a few words."""
    pair = reply.status.details.get("pair")
    between = f": {pair[0]} - {pair[1]}" if isinstance(pair, list | tuple) and len(pair) == 2 else ""
    words = f"{reply.status.name.replace('_', ' ').lower()}{between}"
    mark = rr.Points3D([tip], labels=[words], colors=[FAILURE_COLOR], radii=[0.015 * size], show_labels=True)
    return still("/path/failure", mark)


def _boxes(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    sizes = np.array([shape.halfSide for shape in shapes])
    return functools.partial(rr.Boxes3D, half_sizes=sizes, centers=at[:, :3], quaternions=at[:, 3:])


def _balls(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    return functools.partial(rr.Ellipsoids3D, radii=[shape.radius for shape in shapes], centers=at[:, :3])


def _cylinders(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    lengths, radii = [2.0 * shape.halfLength for shape in shapes], [shape.radius for shape in shapes]
    return functools.partial(rr.Cylinders3D, lengths=lengths, radii=radii, centers=at[:, :3], quaternions=at[:, 3:])


PRIMITIVES: dict[type, tuple[str, Callable[[list[Any], np.ndarray], Callable[..., Any]]]] = {
    coal.Box: ("boxes", _boxes),
    coal.Sphere: ("balls", _balls),
    coal.Cylinder: ("cylinders", _cylinders),
}
"""Name of the entity and the function that draws it, by Coal shape; placements are rows of position and quaternion."""
