"""The sampling judge: distances of a robot's pairs along a curve, by Pinocchio and Coal on the URDF's own geometry.

It looks at places that are even along the way, skips pairs whose balls are far apart, and looks closer where a pair is
nearest. It proves nothing; what it finds is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from doubting import hulls, shapes
from doubting.curve import Curve, Values
from doubting.formula import Formula
from guidefield.messages import scene as messages
from guidefield.messages.requests import AttachedObject
from guidefield.messages.values import Placement
from guidefield.referee.shapes import distance, winding

FAR = 0.1
"""Pairs whose balls are farther apart are not measured exactly, unless all are [m]."""
STEP = 0.06
"""Distance of a coordinate from one sampled place to the next [rad or m]."""
FEWEST, MOST = 24, 160
CLOSER, LEVELS = 8, 4
"""Number of places between two neighbours of a nearest one, and number of times that they are refined."""
CANDIDATES = 4
"""So many nearest places of pairs with obstacles, and of own pairs, are looked at closer, by each of the hopes."""
HOPES = (0.0, 0.25, 0.5)
"""Drops of a distance beside a place that are hoped for, as shares of its rise to a neighbour."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot as the judge knows it.

    Attributes:
        formula: Its URDF.
        left_out: Pairs of links that are not judged, by the robot's own list.
        hulls: Names of shapes for which their hull is judged.
        rest: Values of all joints that follow none.
        tip: The frame that goals are about, unless a request says otherwise.
        size: How many times as large as usual it is: of a large one distances may be off by as much more.
        length: The same of a small one, too: a length that counts as much as an angle of 1 rad [m].
    """

    formula: Formula
    left_out: frozenset[frozenset[str]]
    hulls: frozenset[str]
    rest: Values
    tip: str
    size: float = 1.0
    length: float = 1.0

    @cached_property
    def links(self) -> list[str]:
        """The link of each shape."""
        return [self.formula.model.frames[s.parentFrame].name for s in self.formula.geometry.geometryObjects]

    @cached_property
    def geometry(self) -> Any:
        """The shapes, hulls in the place of meshes for which they are judged."""
        geometry = self.formula.geometry.copy()
        for shape in geometry.geometryObjects:
            if shape.name in self.hulls:
                shape.geometry = shapes.hull_of(shape.geometry) or shape.geometry
            if isinstance(shape.geometry, coal.Sphere):
                shape.geometry = shapes.ball(shape.geometry.radius)
        return geometry

    @cached_property
    def link_hulls(self) -> list[Any]:
        """The hull of each shape that is judged as a mesh; None of others."""
        bodies = [shape.geometry for shape in self.geometry.geometryObjects]
        return [shapes.hull_of(body) if isinstance(body, coal.BVHModelBase) else None for body in bodies]

    @cached_property
    def link_solids(self) -> list[shapes.Surface | None]:
        """The surface of each shape that is judged as a mesh and closed; None of others."""
        bodies = [shape.geometry for shape in self.geometry.geometryObjects]
        return [shapes.solid_of(body) if isinstance(body, coal.BVHModelBase) else None for body in bodies]


@dataclass(frozen=True)
class Setting:
    """The surroundings of a motion that is judged.

    Attributes:
        planned: Joints that the motion moves.
        placement: Of the robot's root.
        obstacles: All of them.
        attached: What links hold.
        allowed: Pairs of names that may touch.
        min_clearance: What moving links have to keep from obstacles [m].
        still: Values of joints that don't move; those left out are at rest.
    """

    planned: frozenset[str]
    placement: Placement
    obstacles: Sequence[messages.Obstacle]
    attached: Sequence[AttachedObject]
    allowed: frozenset[frozenset[str]]
    min_clearance: float
    still: Values = field(default_factory=dict)


@dataclass(frozen=True)
class Nearest:
    """The smallest distance of some pairs.

    Attributes:
        distance: [m]; infinite without pairs.
        time: Where on the curve.
        pair: Names of the two.
        slack: How far what is judged for them may stand off [m].
        index: Of the pair.
    """

    distance: float
    time: float
    pair: tuple[str, str] | None
    slack: float
    index: int = -1


NONE = Nearest(np.inf, 0.0, None, 0.0)


@dataclass(frozen=True, eq=False)
class Sampled:
    """The distances along a curve.

    Attributes:
        obstacle: The nearest of links and obstacles.
        own: The nearest of links and links.
        times: Where it was looked, shape (n,).
        distances: There, shape (n, pairs); a lower bound where it isn't exact [m].
        exact: Where it is, shape (n, pairs).
    """

    obstacle: Nearest
    own: Nearest
    times: np.ndarray
    distances: np.ndarray
    exact: np.ndarray


class Judge:
    """A robot among obstacles."""

    def __init__(self, subject: Subject, setting: Setting) -> None:
        self.subject, self.setting = subject, setting
        self._model, self._data = subject.formula.model, subject.formula.model.createData()
        self._base = shapes.se3(setting.placement)
        self.geometry = subject.geometry.copy()
        self.names = list(subject.links)
        self._slacks = [0.0] * len(self.names)
        self._flights: list[tuple[int, messages.Obstacle, Any]] = []
        moved = subject.formula.moved_by(set(setting.planned))
        added: list[shapes.Body] = []
        self._hold(moved, added)
        robot = len(self.names)
        for obstacle in setting.obstacles:
            self._put(obstacle, added)
        self._choose(moved, robot)
        self._scratch = pin.GeometryData(self.geometry)
        self._radii = np.array([_radius(shape.geometry) for shape in self.geometry.geometryObjects])
        self._solids = [*subject.link_solids, *[body.solid for body in added]]
        around = [*subject.link_hulls, *[body.hull for body in added]]
        self._hulls, meshes = self.geometry.copy(), np.zeros(len(self.names), bool)
        for k, shape in enumerate(self._hulls.geometryObjects):
            if around[k] is not None:
                shape.geometry, meshes[k] = around[k], True
        self._meshes, self._hull_scratch = meshes[self.pairs].any(axis=1), pin.GeometryData(self._hulls)

    def _hold(self, moved: list[frozenset[int]], added: list[shapes.Body]) -> None:
        """Add what links hold, as shapes of their own; what joints move them, and what was added, go into the lists."""
        for one in self.setting.attached:
            frame = self._model.frames[_frame(self._model, one.link)]
            placement = frame.placement * shapes.se3(one.placement) * shapes.frame(one.obstacle)
            above = frozenset(j for j in self._model.supports[frame.parentJoint] if any(j in some for some in moved))
            for k, body in enumerate(shapes.bodies(one.obstacle)):
                name = f"held/{one.obstacle.name}/{k}"
                shape = pin.GeometryObject(name, frame.parentJoint, placement * body.placement, body.shape)
                self.geometry.addGeometryObject(shape)
                self.names.append(one.obstacle.name)
                self._slacks.append(body.slack)
                moved.append(above)
                added.append(body)

    def _put(self, obstacle: messages.Obstacle, added: list[shapes.Body]) -> None:
        """Add an obstacle, its bodies to the list; one that moves is put in its place for each time."""
        if isinstance(obstacle, messages.Polygon) and obstacle.trajectory is not None:
            stand = pin.SE3.Identity()
        else:
            stand = shapes.frame(obstacle)
        for k, body in enumerate(shapes.bodies(obstacle)):
            at = self._base.inverse() * stand * body.placement
            index = self.geometry.addGeometryObject(
                pin.GeometryObject(f"obstacle/{obstacle.name}/{k}", 0, at, body.shape)
            )
            self.names.append(obstacle.name)
            self._slacks.append(body.slack)
            added.append(body)
            if obstacle.trajectory is not None:
                self._flights.append((index, obstacle, body.placement))

    def _choose(self, moved: list[frozenset[int]], robot: int) -> None:
        """Choose the pairs: links that move to each other, and moving links with obstacles."""
        touching = {
            frozenset((one.obstacle.name, link))
            for one in self.setting.attached
            for link in (one.link, *one.touch_links)
        }
        out = self.subject.left_out | self.setting.allowed | touching
        pairs = [
            (i, j)
            for i in range(robot)
            for j in range(i + 1, len(self.names))
            if (moved[i] != moved[j] if j < robot else bool(moved[i]))
            and frozenset((self.names[i], self.names[j])) not in out
            and not (j < robot and self._as_one(i, j))
        ]
        self.moving = [i for i in range(robot) if moved[i]]
        self.geometry.removeAllCollisionPairs()
        for i, j in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.pairs = np.array(pairs, int).reshape(-1, 2)
        self.own = self.pairs[:, 1] < robot
        self.required = np.where(self.own, 0.0, self.setting.min_clearance)
        slacks = np.array([*self._slacks])
        self.slacks = slacks[self.pairs].sum(axis=1)

    def _as_one(self, i: int, j: int) -> bool:
        """Return whether two shapes are fixed to each other."""
        bodies = self.geometry.geometryObjects
        return bool(bodies[i].parentJoint == bodies[j].parentJoint)

    def pair_names(self, pair: int) -> tuple[str, str]:
        return self.names[self.pairs[pair, 0]], self.names[self.pairs[pair, 1]]

    def whole(self, values: Values) -> Values:
        """Values with those of joints that don't move."""
        return {**self.subject.rest, **self.setting.still, **values}

    def configurations(self, values: Values) -> np.ndarray:
        return self.subject.formula.configurations(self.whole(values))

    def along_all(self, curve: Curve, since: float | None = None) -> Sampled:
        """The smallest margins along a curve, from a time on."""
        times = self.places(curve, float(curve.times[0]) if since is None else since)
        if not len(self.pairs):
            return Sampled(NONE, NONE, times, np.empty((len(times), 0)), np.empty((len(times), 0), bool))
        found, exact = self.measured(curve.at(times), times)
        obstacle, own = (self._closer(curve, times, found, chosen) for chosen in (~self.own, self.own))
        return Sampled(obstacle, own, times, found, exact)

    def first_closer(self, curve: Curve, sampled: Sampled, below: np.ndarray, until: float) -> tuple[float, int] | None:
        """A time before another at which a pair is closer than allowed, and the pair; None where none was seen.

        Args:
            curve: The curve.
            sampled: What was found along it.
            below: Distances that are allowed, shape (pairs,) [m].
            until: The time before which it is looked.
        """
        rows, pairs = np.nonzero((sampled.distances < below) & (sampled.times < until)[:, None])
        if len(rows):
            unsure = ~sampled.exact[rows, pairs]
            distances = sampled.distances[rows, pairs]
            distances[unsure] = self.along(curve, sampled.times[rows[unsure]], pairs[unsure])
            for k in np.flatnonzero(distances < below[pairs])[:1].tolist():
                return float(sampled.times[rows[k]]), int(pairs[k])
        return None

    def places(self, curve: Curve, start: float) -> np.ndarray:
        """Times from one on that are even along the way, or in time where obstacles move."""
        end = float(curve.times[-1])
        if end <= start:
            return np.array([start])
        fine = np.union1d(np.linspace(start, end, 8 * MOST), curve.times[curve.times > start])
        travelled = np.r_[0.0, np.cumsum(np.abs(np.diff(curve.local_at(fine), axis=0)).max(axis=1))]
        count = int(np.clip(travelled[-1] / STEP, FEWEST, MOST))
        if self._flights or travelled[-1] <= 0.0:
            return np.linspace(start, end, MOST if self._flights else FEWEST)
        even = np.interp(np.linspace(0.0, travelled[-1], count), travelled + 1e-12 * np.arange(len(fine)), fine)
        even[0], even[-1] = start, end
        return np.unique(even)

    def measured(self, values: Values, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n, pairs) at values of n times [m], lower bounds where that tells enough; and which are exact."""
        qs, found = self.configurations(values), np.empty((len(times), len(self.pairs)))
        flights = self._frames(times)
        far, first, second = max(FAR, 2.0 * self.setting.min_clearance), self.pairs[:, 0], self.pairs[:, 1]
        reach = self._radii[first] + self._radii[second]
        exact = np.zeros(found.shape, bool)
        for k in range(len(times)):
            self._stand(qs[k], flights[k])
            centres = np.array([T.translation for T in self._scratch.oMg])
            found[k] = np.linalg.norm(centres[first] - centres[second], axis=1) - reach
            near = found[k] <= far
            exact[k] = near & ~self._meshes
            for pair in np.flatnonzero(exact[k]).tolist():
                found[k, pair] = self._distance(pair)
            rough = np.flatnonzero(near & self._meshes)
            if len(rough):
                pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_scratch)
            for pair in rough.tolist():
                found[k, pair] = pin.computeDistance(self._hulls, self._hull_scratch, pair).min_distance
        for chosen in (self.own, ~self.own):
            self._settle(qs, flights, found, exact, chosen)
        return found, exact

    def _settle(
        self, qs: np.ndarray, flights: list[list[Any]], found: np.ndarray, exact: np.ndarray, chosen: np.ndarray
    ) -> None:
        """Measure exactly, in place, wherever a bound of some pairs is below the least of them."""
        least = found[exact & chosen].min(initial=np.inf)
        rows, pairs = np.nonzero(~exact & chosen)
        for at in np.argsort(found[rows, pairs], kind="stable").tolist():
            k, pair = int(rows[at]), int(pairs[at])
            if found[k, pair] >= least:
                return
            self._stand(qs[k], flights[k])
            found[k, pair] = self._distance(pair)
            exact[k, pair] = True
            least = min(least, found[k, pair])

    def _frames(self, times: np.ndarray) -> list[list[Any]]:
        """Frames of the obstacles that move, at each of n times."""
        by_flight = [shapes.frames_at(one, times) for _, one, _ in self._flights]
        return [[flight[k] for flight in by_flight] for k in range(len(times))]

    def _stand(self, q: np.ndarray, frames: list[Any]) -> None:
        for (index, _, placement), frame in zip(self._flights, frames, strict=True):
            self.geometry.geometryObjects[index].placement = self._base.inverse() * frame * placement
            self._hulls.geometryObjects[index].placement = self._base.inverse() * frame * placement
        pin.updateGeometryPlacements(self._model, self._data, self.geometry, self._scratch, q)

    def _closer(self, curve: Curve, times: np.ndarray, found: np.ndarray, chosen: np.ndarray) -> Nearest:
        """Look closer where some pairs are nearest."""
        pairs = np.flatnonzero(chosen)
        if not len(pairs):
            return NONE
        mine = found[:, pairs]
        k, at = np.unravel_index(int(np.argmin(mine)), mine.shape)
        best = (float(mine[k, at]), float(times[k]), int(pairs[at]))
        low, high, which = self._candidates(times, mine, pairs)
        a, b = low, high
        for _ in range(LEVELS if len(low) else 0):
            inside = a[:, None] + (b - a)[:, None] * np.arange(1, CLOSER + 1) / (CLOSER + 1)
            distances = self.along(curve, inside.ravel(), np.repeat(which, CLOSER)).reshape(inside.shape)
            lowest = np.argmin(distances, axis=1)
            at = int(np.argmin(distances[np.arange(len(a)), lowest]))
            best = min(best, (float(distances[at, lowest[at]]), float(inside[at, lowest[at]]), int(which[at])))
            centre, width = inside[np.arange(len(a)), lowest], (b - a) / (CLOSER + 1)
            a, b = np.maximum(low, centre - width), np.minimum(high, centre + width)
        return Nearest(best[0], best[1], self.pair_names(best[2]), float(self.slacks[best[2]]), best[2])

    def _distance(self, pair: int) -> float:
        """The distance of a pair where all stands [m]: by Coal, of capsules by the referee's own few lines."""
        i, j = self.pairs[pair].tolist()
        a, b = (self.geometry.geometryObjects[k].geometry for k in (i, j))
        if isinstance(a, coal.Capsule) and isinstance(b, coal.Capsule):
            there = (
                coal.Transform3s(at.rotation, at.translation) for at in (self._scratch.oMg[i], self._scratch.oMg[j])
            )
            return distance(a, next(there), b, next(there))
        return float(pin.computeDistance(self.geometry, self._scratch, pair).min_distance)

    def _candidates(
        self, times: np.ndarray, mine: np.ndarray, pairs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Spans of time about the lowest places of pairs, and the pairs; neighbours tell how low it may be."""
        if len(times) == 1:
            return np.empty(0), np.empty(0), np.empty(0, int)
        padded = np.vstack([mine[1], mine, mine[-2]])
        rise = np.maximum(np.maximum(padded[:-2], padded[2:]) - mine, 0.0)
        lowest = (mine <= padded[:-2]) & (mine <= padded[2:])
        order = []
        for hope in HOPES:
            hoped = np.where(lowest, mine - hope * rise, np.inf)
            order.append(np.argsort(hoped, axis=None)[:CANDIDATES])
        rows, columns = np.unravel_index(np.unique(np.concatenate(order)), mine.shape)
        kept = lowest[rows, columns] & (mine[rows, columns] - HOPES[-1] * rise[rows, columns] <= mine.min())
        rows, columns = rows[kept], columns[kept]
        return times[np.maximum(rows - 1, 0)], times[np.minimum(rows + 1, len(times) - 1)], pairs[columns]

    def along(self, curve: Curve, times: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Distances of a pair at each of n times of a curve, both of shape (n,) [m]."""
        qs, flights, found = self.configurations(curve.at(times)), self._frames(times), np.empty(len(times))
        for k, pair in enumerate(pairs.tolist()):
            self._stand(qs[k], flights[k])
            found[k] = self._distance(pair)
        return found

    def between(self, names: Sequence[str]) -> np.ndarray:
        """The pairs of two names."""
        return np.array([p for p in range(len(self.pairs)) if set(self.pair_names(p)) == set(names)], int)

    def of_points(self, names: Sequence[str]) -> bool:
        """Return whether one of two names is a point cloud's, whose balls are judged by what surrounds them."""
        everything = [*self.setting.obstacles, *(one.obstacle for one in self.setting.attached)]
        return any(isinstance(one, messages.PointCloud) and one.name in names for one in everything)

    def least_at(self, curve: Curve, time: float) -> float:
        """The smallest distance of links and obstacles at a time of a curve [m]."""
        at = np.array([time])
        return float(self.measured(curve.at(at), at)[0][0, ~self.own].min(initial=np.inf))

    def otherwise(self, curve: Curve, nearest: Nearest) -> float | None:
        """The distance of the nearest pair by another algorithm than Coal's [m]; None where there is none."""
        if nearest.index < 0 or nearest.distance <= 0.0:
            return None
        at = np.array([nearest.time])
        self.along(curve, at, np.array([nearest.index]))
        i, j = self.pairs[nearest.index].tolist()
        bodies = self.geometry.geometryObjects
        return hulls.distance(bodies[i].geometry, self._scratch.oMg[i], bodies[j].geometry, self._scratch.oMg[j])

    @property
    def ends(self) -> float:
        """Return when the last obstacle comes to rest [s]."""
        return max((one.trajectory.times[-1] for _, one, _ in self._flights if one.trajectory), default=0.0)

    def distances_at(self, values: Values, time: float = 0.0) -> np.ndarray:
        """Exact distances of all pairs at values of one row, at rest, at a time [s]: shape (pairs,) [m]."""
        frames = [shapes.frames_at(one, np.array([time]))[0] for _, one, _ in self._flights]
        self._stand(self.configurations(values)[0], frames)
        return np.array([self._distance(p) for p in range(len(self.pairs))])

    def touches_at(self, values: Values) -> bool:
        """Tell whether a pair is in contact, or one inside the other, at values of one row, at rest and time 0."""
        self._stand(self.configurations(values)[0], self._frames(np.zeros(1))[0])
        touching = (pin.computeCollision(self.geometry, self._scratch, pair) for pair in range(len(self.pairs)))
        return any(touching) or self._enclosed() is not None

    def towards_first(self, pair: int) -> np.ndarray:
        """The unit vector (3,) from the second body of a pair to the first where they are closest, in the world."""
        result = pin.computeDistance(self.geometry, self._scratch, pair)
        between = np.array(result.getNearestPoint1()) - np.array(result.getNearestPoint2())
        length = float(np.linalg.norm(between))
        unit = between / length if length > 0.0 and result.min_distance > 0.0 else -np.array(result.normal)
        return self._base.rotation @ unit

    def moving_centres(self) -> np.ndarray:
        """Return where shapes are that move, shape (n, 3) [m, world]."""
        return np.array([self._base.act(self._scratch.oMg[i].translation) for i in self.moving])

    def frame_at(self, values: Values, frame: str) -> Any:
        """Return where a frame is at values of one row, in the world."""
        pin.forwardKinematics(self._model, self._data, self.configurations(values)[0])
        return self._base * pin.updateFramePlacement(self._model, self._data, _frame(self._model, frame))

    def frame_placements(self, curve: Curve, times: np.ndarray, frame: str) -> list[Any]:
        """Return where a frame is at times (n,) of a curve, in the world."""
        index, found = _frame(self._model, frame), []
        for q in self.configurations(curve.at(times)):
            pin.forwardKinematics(self._model, self._data, q)
            found.append(self._base * pin.updateFramePlacement(self._model, self._data, index))
        return found

    @property
    def moves(self) -> bool:
        """Return whether an obstacle moves."""
        return bool(self._flights)

    def least_of(self, curve: Curve, names: frozenset[str]) -> float:
        """The smallest distance of pairs of some names along a curve, at many times [m]."""
        times = np.union1d(
            np.linspace(curve.times[0], curve.times[-1], 20 * MOST), self.places(curve, float(curve.times[0]))
        )
        pairs = self.between(list(names)).tolist()
        return min((float(self.along(curve, times, np.full(len(times), p)).min()) for p in pairs), default=np.inf)

    def enclosed(self, curve: Curve, time: float) -> tuple[str, str] | None:
        """A pair of which one is wholly inside the other, a closed mesh, at a time; None without one."""
        at = np.array([time])
        self._stand(self.configurations(curve.at(at))[0], self._frames(at)[0])
        return self._enclosed()

    def enclosed_at(self, values: Values, time: float = 0.0) -> tuple[str, str] | None:
        """The same at values of the joints, at rest, at a time [s]."""
        self._stand(self.configurations(values)[0], self._frames(np.array([time]))[0])
        return self._enclosed()

    def _enclosed(self) -> tuple[str, str] | None:
        for pair, (i, j) in enumerate(self.pairs.tolist()):
            for outer, inner in ((i, j), (j, i)):
                solid, body = self._solids[outer], self.geometry.geometryObjects[inner].geometry
                if solid is None or isinstance(body, coal.Halfspace):
                    continue
                point = np.array(body.vertices())[0] if isinstance(body, coal.BVHModelBase) else np.zeros(3)
                if isinstance(body, coal.Convex):
                    point = np.array(body.points()).mean(axis=0)
                inside = self._scratch.oMg[outer].actInv(self._scratch.oMg[inner].act(point))
                if np.linalg.norm(inside) > self._radii[outer] or abs(winding(inside, solid[0][solid[1]])) < 0.5:
                    continue
                if self._distance(pair) > 0.0:
                    return self.pair_names(pair)
        return None


def _frame(model: Any, name: str) -> int:
    """Index of the frame of a link, or else of a joint, of that name; Pinocchio's own frame of the world is neither."""
    named = [index for index, frame in enumerate(model.frames) if index and frame.name == name]
    return next((index for index in named if model.frames[index].type == pin.BODY), named[0])


def _radius(shape: Any) -> float:
    """Of a ball about a shape's own origin that contains it [m]."""
    if isinstance(shape, coal.Halfspace):
        return np.inf
    if isinstance(shape, coal.BVHModelBase):
        return float(np.linalg.norm(np.array(shape.vertices()), axis=1).max())
    shape.computeLocalAABB()
    return float(np.linalg.norm(shape.aabb_center) + shape.aabb_radius)
