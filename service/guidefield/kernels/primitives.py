"""Charged spheres, capsules and planes at a point, in closed form.

The sphere and the plane are exact integrals int dS / |p - r|^3. The capsule is a surrogate with the exact total
charge: a tube, exact where it is infinitely long, and half a sphere at each end. It diverges on the whole surface of
the capsule, is exact for length 0 and within a few tens of per cent of the integral elsewhere.

With `curvature` is meant what -2 Phi_h/h is for a triangle: the second derivative along the normal of the surface.
Selects instead of branches, so that the compiler evaluates several primitives at once.
"""

from __future__ import annotations

import math

from guidefield.kernels.signatures import Six, Vector3, inlined

CAPSULE_SHELL = 0.01
"""A point nearer to a capsule than this part of its radius, or inside it, has the field of this distance."""

_ON_AXIS = 1e-24
"""Square of the distance from a capsule's axis, over its size and the point's distance, that counts as none."""

_GAP_MIN = 1e-30
"""Least distance to the surface of a sphere or plane [m]; keeps points on it finite."""


@inlined
def _inside(height: float) -> float:
    """Winding number of a closed surface at a signed distance from it."""
    return 1.0 if height < 0.0 else (0.5 if height == 0.0 else 0.0)


@inlined
def _across(u: Vector3) -> Vector3:
    """A vector across the unit vector u, at least 0.7 long; (1, 0, 0) if u is zero."""
    along_x = u[0] * u[0] > 0.5
    none = u[0] == 0.0 and u[1] == 0.0 and u[2] == 0.0
    return (1.0 if none else (u[2] if along_x else 0.0), 0.0 if along_x else -u[2], -u[0] if along_x else u[1])


@inlined
def _tube(z1: float, z2: float, rho: float, R1: float, R2: float, radius: float) -> Vector3:
    """Tube with ends at axial coordinates z1 <= z2 from the point: potential, axial slope, radial slope over rho.

    With b2 = rho^2 - a^2 and R_i^2 = z_i^2 + b2 the potential is (2 pi a/b2) (z2/R2 - z1/R1). Beyond an end, where
    the difference cancels and b2 may be negative, it is made rational with q = z2 R1 + z1 R2.
    """
    charge = 2.0 * math.pi * radius
    b2 = (rho - radius) * (rho + radius)
    beyond = z1 * z2 > 0.0
    inverse = 1.0 / (z2 * R1 + z1 * R2 if beyond else b2)
    i1 = 1.0 / R1
    i2 = 1.0 / R2
    # (z2 - z1) (z2 + z1) = R2^2 - R1^2
    imbalance = charge * (z2 - z1) * (z1 + z2) * (i1 * i2)
    rational = imbalance * inverse
    radial_beyond = -rational * (i1 * i1 + i2 * i2 + (z2 * i1 + z1 * i2) * inverse)
    f1 = z1 * i1
    f2 = z2 * i2
    radial_beside = -charge * inverse * inverse * (f2 * (2.0 + b2 * i2 * i2) - f1 * (2.0 + b2 * i1 * i1))
    axial = imbalance * (i1 * i1 + i1 * i2 + i2 * i2) / (R1 + R2)
    potential = rational if beyond else charge * inverse * (f2 - f1)
    return potential, axial, radial_beyond if beyond else radial_beside


@inlined
def _half_sphere(r: float, R: float, radius: float) -> tuple[float, float]:
    """Half a charged sphere's field outside, R^2 = r^2 - a^2: potential, slope over the distance r from the centre."""
    i = 1.0 / (r * R)
    potential = 2.0 * math.pi * radius * radius * r * (i * i)
    return potential, -potential * (3.0 * r * r - radius * radius) * (i * i)


@inlined
def _capsule(p: Vector3, p0: Vector3, p1: Vector3, radius: float) -> tuple[float, float, float, float, float]:
    """Potential, gradient (3) and the distance from the axis segment."""
    ax, ay, az = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    over = 1.0 / length if length > 0.0 else 0.0
    u = (ax * over, ay * over, az * over)
    dx, dy, dz = p[0] - p0[0], p[1] - p0[1], p[2] - p0[2]
    s = dx * u[0] + dy * u[1] + dz * u[2]
    excess = s - min(max(s, 0.0), length)
    wx, wy, wz = dx - s * u[0], dy - s * u[1], dz - s * u[2]
    square = wx * wx + wy * wy + wz * wz + excess * excess
    # So near that rounding would choose the direction, which then need not be across the axis.
    on_axis = square <= _ON_AXIS * (dx * dx + dy * dy + dz * dz + length * length)
    vx, vy, vz = _across(u)
    wx, wy, wz = vx if on_axis else wx, vy if on_axis else wy, vz if on_axis else wz
    distance = math.sqrt(vx * vx + vy * vy + vz * vz if on_axis else square)
    # Out to the shell, away from the nearest point of the axis.
    shell = (1.0 + CAPSULE_SHELL) * radius
    scale = shell / distance if on_axis or distance < shell else 1.0
    s += (scale - 1.0) * excess
    wx, wy, wz = scale * wx, scale * wy, scale * wz
    square_across = wx * wx + wy * wy + wz * wz
    r1 = math.sqrt(s * s + square_across)
    r2 = math.sqrt((length - s) * (length - s) + square_across)
    R1 = math.sqrt((r1 - radius) * (r1 + radius))
    R2 = math.sqrt((r2 - radius) * (r2 + radius))
    tube, axial, radial = _tube(-s, length - s, math.sqrt(square_across), R1, R2, radius)
    cap1, slope1 = _half_sphere(r1, R1, radius)
    cap2, slope2 = _half_sphere(r2, R2, radius)
    across = radial + slope1 + slope2
    along = axial + slope1 * s + slope2 * (s - length)
    gx, gy, gz = across * wx + along * u[0], across * wy + along * u[1], across * wz + along * u[2]
    return tube + cap1 + cap2, gx, gy, gz, 0.0 if on_axis else distance


@inlined
def charged_capsule_at(p: Vector3, p0: Vector3, p1: Vector3, radius: float) -> Six:
    """Field of a capsule of unit charge per area at a point: `capsule_at`, curvature and winding number.

    The curvature is that of the law c/d with this potential and this slope, 2 |grad Phi|^2 / Phi, which the capsule
    follows near its surface; it is never negative.
    """
    potential, gx, gy, gz, distance = _capsule(p, p0, p1, radius)
    curvature = 2.0 * (gx * gx + gy * gy + gz * gz) / potential
    return potential, gx, gy, gz, curvature, _inside(distance - radius)


@inlined
def capsule_at(
    x: float, y: float, z: float, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, radius: float
) -> tuple[float, float, float, float]:
    """Potential [1/m] and gradient (3) [1/m^2] of a capsule of unit charge per area at a point.

    Nearer than `CAPSULE_SHELL` radii to the surface, and inside, both are those at that distance from it, on the ray
    from the nearest point of the axis: finite, continuous except at the two ends of the axis, and pointing outwards
    (on the axis itself across it, in an arbitrary direction). There the gradient is not the derivative of the
    potential, which is constant along the ray.

    Args:
        x: Point [m], with y and z.
        y: See x.
        z: See x.
        x0: One end of the axis [m], with y0 and z0.
        y0: See x0.
        z0: See x0.
        x1: Other end of the axis [m], with y1 and z1; may be the same (a sphere).
        y1: See x1.
        z1: See x1.
        radius: Radius [m], positive.
    """
    potential, gx, gy, gz, _ = _capsule((x, y, z), (x0, y0, z0), (x1, y1, z1), radius)
    return potential, gx, gy, gz


@inlined
def sphere_at(p: Vector3, centre: Vector3, radius: float) -> Six:
    """Field of a sphere (a shell) of unit charge per area at a point.

    The potential is 4 pi a^2 / (r (r^2 - a^2)) outside and 4 pi a / (a^2 - r^2) inside, where the field is finite and
    pushes towards the centre, as that of a closed mesh does. The curvature is its second derivative along the radius,
    positive. The winding number is 1 inside, 1/2 on the sphere, else 0. On the sphere itself all are finite.
    """
    dx, dy, dz = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    rr = dx * dx + dy * dy + dz * dz
    r = math.sqrt(rr)
    aa = radius * radius
    gap = max(abs(r - radius), _GAP_MIN) * (r + radius)
    outside = r >= radius
    potential = 4.0 * math.pi * radius / gap * (radius / r if outside else 1.0)
    slope = potential / gap * (-(3.0 * rr - aa) / rr if outside else 2.0)
    spread = (12.0 * rr * rr - 6.0 * aa * rr + 2.0 * aa * aa) / rr if outside else 2.0 * aa + 6.0 * rr
    curvature = potential / (gap * gap) * spread
    return potential, slope * dx, slope * dy, slope * dz, curvature, _inside(r - radius)


@inlined
def plane_at(p: Vector3, normal: Vector3, offset: float) -> Six:
    """Field of an infinite plane of unit charge per area at a point, the boundary of the half space behind it.

    The potential is 2 pi/h, h the distance from the plane, the curvature 4 pi/h^3. The winding number is that of the
    half space: 1 behind the plane, 1/2 on it, else 0. On the plane itself all are finite.
    """
    height = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset
    h = max(abs(height), _GAP_MIN)
    potential = 2.0 * math.pi / h
    curvature = 2.0 * potential / (h * h)
    slope = -0.5 * curvature * height
    return potential, slope * normal[0], slope * normal[1], slope * normal[2], curvature, _inside(height)
