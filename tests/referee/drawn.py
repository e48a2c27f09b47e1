"""Random robots, obstacles and motions: joints of every kind, obstacles of every kind, at rest or moving."""

import dataclasses
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.case_file import Motion
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build
from tests.robots import JOINTS, box_arm, grouped
from tests.scene.solids import box_mesh, l_prism, room

MIMICS = ("mimic", "gear", "half-gear", "screw")
SOURCES = ("x", "y", "wide", "oblique", "continuous", "oblique-continuous", "slide")
SEVERAL = ("planar", "floating")


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A motion, and what it was drawn from."""

    chain: str
    motion: Motion


def draw(rng: np.random.Generator, moving: bool, executed: bool = False) -> Drawn:
    """A motion of a short arm among a few obstacles; the joints' limits are out of the way.

    One that is `executed` is what a controller may draw, of any kind, with what the arm may be beside it.
    """
    chain = _chain(rng)
    planned = grouped(box_arm(chain, 1))
    endless = {"lower": np.full(planned.nv, -np.inf), "upper": np.full(planned.nv, np.inf)}
    limits = {"velocity_limits": np.full(planned.nv, np.inf), "acceleration_limits": np.full(planned.nv, np.inf)}
    planned = dataclasses.replace(planned, **endless, **limits)
    obstacles = [_obstacle(rng, f"o{index}", moving) for index in range(int(rng.integers(1, 4)))]
    world = World.build(planned, build(messages.Scene(name="drawn", obstacles=obstacles)))
    clearance = float(rng.choice([0.0, 0.0, 0.02]))
    motion = Motion(world, Placement(), (), *_curve(rng, planned), min_clearance=clearance)
    return Drawn(chain, _as_executed(rng, motion) if executed else motion)


def _as_executed(rng: np.random.Generator, motion: Motion) -> Motion:
    """The motion as a controller may draw it: straight, cubic, of degree 5, or in steps."""
    kind = rng.integers(0, 4)
    beside = rng.uniform(0.0, float(rng.choice([0.002, 0.02])), motion.positions.shape[1])
    motion = dataclasses.replace(motion, tolerance=beside if rng.random() < 0.9 else None)
    if kind == 1:
        return motion
    if kind == 2:
        return dataclasses.replace(motion, accelerations=0.3 * rng.normal(size=motion.positions.shape))
    if kind == 3:
        assert motion.times is not None, "it has times"
        times = np.linspace(motion.times[0], motion.times[-1], 12)
        line = [np.interp(times, motion.times, column) for column in motion.positions.T]
        return dataclasses.replace(motion, times=times, positions=np.array(line).T, velocities=None, steps=True)
    return dataclasses.replace(motion, velocities=None)


def _chain(rng: np.random.Generator) -> str:
    first = str(rng.choice([*SOURCES, *SEVERAL]))
    others = [kind for kind in JOINTS if first in SOURCES or kind not in MIMICS]
    return " ".join([first, *map(str, rng.choice(others, int(rng.integers(0, 3))))])


def _curve(rng: np.random.Generator, planned: PlanningGroup) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    count, spread = int(rng.integers(2, 4)), float(rng.choice([0.02, 0.2, 1.0]))
    start = planned.to_local(planned.part_of(planned.robot.rest))
    steps = rng.normal(size=(count, planned.nv)) * spread
    times = np.r_[0.0, np.cumsum(rng.uniform(0.3, 2.0, count - 1))]
    return times, start + np.cumsum(steps, axis=0), 0.3 * spread * rng.normal(size=steps.shape)


def _turned(rng: np.random.Generator) -> tuple[float, float, float, float]:
    x, y, z, w = _unit(rng.normal(size=4))
    return float(x), float(y), float(z), float(w)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _obstacle(rng: np.random.Generator, name: str, moving: bool) -> Any:
    position = _unit(rng.normal(size=3)) * rng.uniform(0.15, 1.1)
    place: dict[str, Any] = {"position": tuple(position.tolist()), "quaternion_xyzw": _turned(rng)}
    kind = list(KINDS)[int(rng.integers(0, len(KINDS)))]
    made = KINDS[kind](rng, name, rng.uniform(0.03, 0.25, 3), place)
    if not moving:
        return made
    times = np.cumsum(rng.uniform(0.1, 1.0, int(rng.integers(1, 4)))) - 0.3
    stops = [Placement(tuple((position + 0.3 * rng.normal(size=3)).tolist()), _turned(rng)) for _ in times]
    return msgspec.structs.replace(made, trajectory=messages.ObstacleTrajectory(times.tolist(), stops))


def _mesh(rng: np.random.Generator, name: str, size: np.ndarray, place: dict[str, Any]) -> messages.Mesh:
    """Closed: convex, bent, or with a hollow; some with faces turned over, some with cracks of 0.4 mm."""
    vertices, triangles = [l_prism(), room(2.0, 1.5), box_mesh(1.5)][int(rng.integers(0, 3))]
    vertices, triangles = vertices * size[0] * 2.0, triangles.copy()
    if rng.random() < 0.3:
        over = rng.random(len(triangles)) < 0.5
        triangles[over] = triangles[over][:, ::-1]
    if rng.random() < 0.3:
        vertices = vertices[triangles].reshape(-1, 3) + rng.uniform(-2e-4, 2e-4, (3 * len(triangles), 3))
        triangles = np.arange(len(vertices)).reshape(-1, 3)
    corners, faces = ([tuple(row) for row in some.tolist()] for some in (vertices, triangles))
    return messages.Mesh(name=name, vertices=corners, triangles=faces, **place)


def _polygon(rng: np.random.Generator, name: str, size: np.ndarray, place: dict[str, Any]) -> messages.Polygon:
    """Star-shaped, so that it may be dented."""
    angles = 2.0 * np.pi * np.arange(7) / 7
    radii = rng.uniform(0.3, 1.5, 7) * size[0]
    flat = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), 0.0 * angles])
    x, y, z, w = place["quaternion_xyzw"]
    corners = flat @ pin.Quaternion(w, x, y, z).matrix().T + place["position"]
    return messages.Polygon(name=name, vertices=[tuple(row) for row in corners.tolist()])


def _half_space(rng: np.random.Generator, name: str, size: np.ndarray, place: dict[str, Any]) -> messages.HalfSpace:
    normal = _unit(rng.normal(size=3))
    return messages.HalfSpace(name=name, normal=tuple((2.0 * normal).tolist()), offset=-2.0 * rng.uniform(0.2, 1.2))


def _cloud(rng: np.random.Generator, name: str, size: np.ndarray, place: dict[str, Any]) -> messages.PointCloud:
    points = np.array(place["position"]) + rng.normal(size=(20, 3)) * size[1]
    return messages.PointCloud(name=name, points=[tuple(row) for row in points.tolist()], radius=float(0.2 * size[0]))


KINDS: dict[str, Callable[..., Any]] = {
    "box": lambda rng, name, size, place: messages.Box(name=name, size=tuple(size.tolist()), **place),
    "sphere": lambda rng, name, size, place: messages.Sphere(
        name=name, radius=float(size[0]), position=place["position"]
    ),
    "cylinder": lambda rng, name, size, place: messages.Cylinder(
        name=name, radius=float(size[0]), length=float(size[1]), **place
    ),
    "capsule": lambda rng, name, size, place: messages.Capsule(
        name=name, radius=float(size[0]), length=float(size[1]), **place
    ),
    "mesh": _mesh,
    "polygon": _polygon,
    "half_space": _half_space,
    "point_cloud": _cloud,
}
