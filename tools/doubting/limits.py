"""Extremes of a curve beside its limits: of its cubics in closed form, limits as URDF and request say."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from tests.planner.limit_attack import extremes, ranges

from doubting.curve import ROTATION, Curve
from doubting.loaded import Loaded
from guidefield.messages.requests import CertifyRequest, PlanRequest
from guidefield.robot.model.joints import LimitSource

Request = PlanRequest | CertifyRequest
RATES = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class Standing:
    """The extremes of a curve beside its limits.

    Attributes:
        excess: The farthest that a joint is beyond a limit of the URDF [rad or m]; negative within.
        joint: Which joint that is.
        shares: The largest share of each limit of a rate, of the local coordinates.
        noise: How far off those may be for rounding.
        extremes: By joint of one coordinate: least and largest position, largest velocity, acceleration and jerk.
    """

    excess: float
    joint: str
    shares: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    extremes: dict[str, tuple[float, ...]] = field(default_factory=dict)


def standing(loaded: Loaded, request: Request, curve: Curve) -> Standing:
    """Compare a curve with the limits of a robot and of a request."""
    scalar = {part.name: part.at.start for part in curve.parts if part.width == 1}
    z, rest = curve.points, []
    if curve.rates is None or len(curve.times) == 1:  # one row stands still
        low, high = z.min(axis=0), z.max(axis=0)
    else:
        low, high, *rest = extremes(curve.times, z, curve.rates)
    worst = max(_excesses(loaded, scalar, low, high), default=(-np.inf, ""))
    if not rest:
        return Standing(*worst)
    by_joint = {name: tuple(float(one[k]) for one in (low, high, *rest)) for name, k in scalar.items()}
    limits = {rate: _limits(loaded, request, curve, rate) for rate in RATES}
    shares = {rate: float((rest[k] / limits[rate]).max(initial=0.0)) for k, rate in enumerate(RATES)}
    return Standing(*worst, shares, _noise(curve, z, limits), by_joint)


def _limits(loaded: Loaded, request: Request, curve: Curve, rate: str) -> np.ndarray:
    """Limits of a rate of the local coordinates, shape (nv,); infinite where there is none.

    A joint that others follow is as slow as each of these needs it to be, by limits that somebody stated.
    """
    found = np.empty(curve.points.shape[1])
    scale = {"velocity": request.max_velocity_scaling_factor, "acceleration": request.max_acceleration_scaling_factor}
    for part in curve.parts:
        found[part.at] = _own(loaded, request, part.name, rate)
        for name, (source, multiplier) in _find_mimics(loaded).items():
            if source == part.name and multiplier != 0.0:
                found[part.at] = np.minimum(found[part.at], _own(loaded, request, name, rate) / abs(multiplier))
        found[part.at] *= scale.get(rate, 1.0)
    return found


def _find_mimics(loaded: Loaded) -> dict[str, tuple[str, float]]:
    """By joint that follows another: the one at the end of its chain, and how many times as much it moves."""
    followed, found = loaded.subject.formula.followed, {}
    for name in followed:
        source, total = name, 1.0
        while source in followed:
            source, multiplier, _ = followed[source]
            total *= multiplier
        found[name] = source, total
    return found


def _own(loaded: Loaded, request: Request, name: str, rate: str) -> np.ndarray | float:
    """A joint's limit by itself; of one that follows another only if somebody stated it, or what it comes of."""
    asked, known = request.limits.get(name), loaded.model.joint(name)
    given = None if asked is None else getattr(asked, rate)
    if given is not None:
        return float(given)
    if rate == "jerk":
        return np.inf
    source = known.velocity_source
    if rate == "acceleration" and known.acceleration_source is not LimitSource.DEFAULT:
        source = known.acceleration_source
    unsaid = known.mimic is not None and source is LimitSource.DEFAULT
    own: np.ndarray = getattr(known, rate)
    return np.inf if unsaid else own


def _excesses(loaded: Loaded, at: dict[str, int], low: np.ndarray, high: np.ndarray) -> list[tuple[float, str]]:
    """Of each joint that moves, or follows one that does, how far it is beyond its limits.

    That of a mimic joint is attributed to its source joint. If the limits of two mimic joints contradict each other,
    those of one are not kept, and the robot says so.
    """
    found = []
    for name, (lower, upper, scale, offset, source) in ranges(loaded.text).items():
        known = loaded.model.joint(name)
        if source in at and known is not None and np.isfinite([known.lower[0], known.upper[0]]).any():
            ends = scale * low[at[source]] + offset, scale * high[at[source]] + offset
            beyond = float(max(lower - min(ends), max(ends) - upper))
            found.append((beyond / max(1.0, abs(scale)), name))
    return found


def _noise(curve: Curve, z: np.ndarray, limits: dict[str, np.ndarray]) -> dict[str, float]:
    """Bound the rounding of each share: positions are divided by a power of the shortest time."""
    shortest = float(np.diff(curve.times).min(initial=np.inf))
    rounding = 64.0 * np.finfo(float).eps * (1.0 + np.abs(z).max(initial=0.0)) * _conditioning(curve)
    return {
        rate: float(rounding / shortest ** (k + 1) / limits[rate].min(initial=np.inf)) for k, rate in enumerate(RATES)
    }


def _conditioning(curve: Curve) -> float:
    """By how much a rotation vector is more uncertain than its quaternion: without bound towards a whole turn."""
    worst = 1.0
    for part in curve.parts:
        if part.width in ROTATION:
            half = 0.5 * np.linalg.norm(curve.points[:, part.at][:, ROTATION[part.width]], axis=1)
            worst = max(worst, float((1.0 / np.maximum(np.abs(np.sinc(half / np.pi)), 1e-6)).max(initial=1.0)))
    return worst
