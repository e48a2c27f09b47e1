"""Obstacles that move in simulations of streams: some drift and are reflected, some hunt the robot, some turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import coal
import numpy as np

from doubting import shapes
from guidefield.messages.scene import PointCloud
from guidefield.referee.shapes import surface

OCTAHEDRON = (
    np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]),
)
"""Vertices (6, 3) and triangles (8, 3), counter-clockwise from outside."""

Steering = Callable[["Mover", float, float, np.ndarray], None]
"""Changes a mover's velocity: the mover, the time and the step [s], the centres of the robot's bodies (n, 3)."""


@dataclass
class Mover:
    """An obstacle that moves, never faster than it declares.

    Attributes:
        message: Its shape, as a stream's `obstacle`.
        largest: Its largest speed [m/s].
        position: Of its frame [m, world].
        velocity: [m/s].
        rotation: Of its frame in the world.
        spin: Angular velocity [rad/s, world].
        steer: Changes its velocity.
    """

    message: Any
    largest: float
    position: np.ndarray
    velocity: np.ndarray
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    spin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    steer: Steering = lambda *_: None

    def step(self, time: float, dt: float, bodies: np.ndarray) -> None:
        """Move on for a while dt [s]; bodies (n, 3) are where the robot's are."""
        self.steer(self, time, dt, bodies)
        self.position = self.position + dt * self.velocity
        angle = math.hypot(*self.spin) * dt
        if angle > 0.0:
            self.rotation = (
                coal.AngleAxis(angle, self.spin / np.linalg.norm(self.spin)).toRotationMatrix() @ self.rotation
            )

    @property
    def name(self) -> str:
        """The name of its obstacle."""
        return str(self.message.name)

    @cached_property
    def shape(self) -> coal.CollisionGeometry:
        """Its shape for Coal; of a cloud octahedra within the balls."""
        if not isinstance(self.message, PointCloud):
            return shapes.bodies(self.message)[0].shape
        points = np.array(self.message.points)
        vertices = (points[:, None] + self.message.radius * OCTAHEDRON[0]).reshape(-1, 3)
        triangles = (6 * np.arange(len(points))[:, None, None] + OCTAHEDRON[1]).reshape(-1, 3)
        return surface(vertices, triangles)

    @cached_property
    def radius(self) -> float:
        """Of a ball about its frame's origin that holds it [m]."""
        return radius_of(self.shape)

    @property
    def quaternion(self) -> tuple[float, ...]:
        """Its rotation, (x, y, z, w)."""
        return tuple(coal.Quaternion(self.rotation).coeffs().tolist())


def reflected(centre: np.ndarray, radius: float, inner: float) -> Steering:
    """Straight on, and reflected where the centre would leave a ball, sink below the ground or come to the base.

    Args:
        centre: Of the ball, shape (3,) [m].
        radius: Its radius [m].
        inner: Radius of the ball about the base, and of the upright cylinder below that ball's centre [m].
    """

    base = centre[:2].tolist()

    def steer(mover: Mover, _: float, dt: float, __: np.ndarray) -> None:
        ahead = mover.position + dt * mover.velocity
        x, y, z = ahead.tolist()
        across, away = math.hypot(x - base[0], y - base[1]), math.dist((x, y, z), centre)
        normals = []
        if z < 0.0:
            normals.append(np.array([0.0, 0.0, 1.0]))
        if away > radius:
            normals.append((centre - ahead) / away)
        if z < centre[2] and across < inner:
            normals.append(np.array([x - base[0], y - base[1], 0.0]) / across)
        elif away < inner:
            normals.append((ahead - centre) / away)
        for normal in normals:
            into = float(mover.velocity @ normal)
            if into < 0.0:
                mover.velocity = mover.velocity - 2.0 * into * normal

    return steer


def hunting(mover: Mover, _: float, __: float, bodies: np.ndarray) -> None:
    """Towards the nearest of the robot's bodies (n, 3), as fast as it may."""
    ways = bodies - mover.position
    far = np.linalg.norm(ways, axis=1)
    nearest = int(np.argmin(far))
    mover.velocity = ways[nearest] * (mover.largest / max(1e-9, float(far[nearest])))


def radius_of(shape: coal.CollisionGeometry) -> float:
    """Of a ball about the origin that holds a shape [m]."""
    shape.computeLocalAABB()
    box = shape.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(np.array(box.min_)), np.abs(np.array(box.max_)))))
