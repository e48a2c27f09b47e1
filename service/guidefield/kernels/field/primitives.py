"""Charged spheres, capsules and planes at a point, in closed form.

The sphere and the plane are exact integrals int dS / |p - r|^3. The capsule is a surrogate with the exact total
charge: a tube, exact where it is infinitely long, and half a sphere at each end. It diverges on the whole surface of
the capsule, is exact for length 0 and within a few tens of per cent of the integral elsewhere.

With `curvature` is meant what -2 Phi_h/h is for a triangle: the second derivative along the normal of the surface.
Points are numbers or lanes (kernels/simd/vector.py), a primitive's own numbers are plain.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.field.solid_angle import positive
from guidefield.kernels.jit.signatures import Six, Vector3, inlined
from guidefield.kernels.simd.vector import inverse_root, is_double, root, select

CAPSULE_SHELL = 0.01
"""A point nearer to a capsule than this part of its radius, or inside it, has the field of this distance."""

_ON_AXIS = 1e-24
_ON_AXIS_SINGLE = 1e-10
"""Square of the distance from a capsule's axis, over its size and the point's distance, that counts as none."""

Lane = Any
"""A number, or lanes of them."""


@inlined
def winding_behind(height: Lane) -> Lane:
    """Winding number of a closed surface at a signed distance from it: 1 inside, 1/2 on it, 0 outside."""
    return select(height < 0.0, 1.0, select(height > 0.0, 0.0, 0.5 + 0.0 * height))


@inlined
def _across(u: Vector3) -> Vector3:
    """A vector across the unit vector u, at least 0.7 long; (1, 0, 0) if u is zero."""
    along_x = u[0] * u[0] > 0.5
    none = u[0] == 0.0 and u[1] == 0.0 and u[2] == 0.0
    return (1.0 if none else (u[2] if along_x else 0.0), 0.0 if along_x else -u[2], -u[0] if along_x else u[1])


@inlined
def _tube(
    z1: Lane, z2: Lane, b2: Lane, i1: Lane, i2: Lane, R1: Lane, R2: Lane, radius: float
) -> tuple[Lane, Lane, Lane]:
    """Tube with ends at axial coordinates z1 <= z2 from the point: potential, axial slope, radial slope over rho.

    With b2 = rho^2 - a^2, R_i^2 = z_i^2 + b2 and i_i = 1/R_i the potential is (2 pi a/b2) (z2/R2 - z1/R1). Beyond an
    end, where the difference cancels and b2 may be negative, it is made rational with q = z2 R1 + z1 R2.
    """
    charge = 2.0 * math.pi * radius
    beyond = z1 * z2 > 0.0
    sum_of_roots = R1 + R2
    denominator = select(beyond, z2 * R1 + z1 * R2, b2)
    over = 1.0 / (denominator * sum_of_roots)
    inverse = over * sum_of_roots
    # (z2 - z1) (z2 + z1) = R2^2 - R1^2
    imbalance = charge * (z2 - z1) * (z1 + z2) * (i1 * i2)
    rational = imbalance * inverse
    radial_beyond = -rational * (i1 * i1 + i2 * i2 + (z2 * i1 + z1 * i2) * inverse)
    f1 = z1 * i1
    f2 = z2 * i2
    radial_beside = -charge * inverse * inverse * (f2 * (2.0 + b2 * i2 * i2) - f1 * (2.0 + b2 * i1 * i1))
    axial = imbalance * (i1 * i1 + i1 * i2 + i2 * i2) * (over * denominator)
    potential = select(beyond, rational, charge * inverse * (f2 - f1))
    return potential, axial, select(beyond, radial_beyond, radial_beside)


@inlined
def _half_sphere(rr: Lane, i: Lane, radius: float) -> tuple[Lane, Lane]:
    """Half a charged sphere's field outside, from r^2 and i = 1/sqrt(r^2 - a^2): potential, slope over r."""
    j = inverse_root(rr)
    square = i * i * j * j
    potential = 2.0 * math.pi * radius * radius * (i * i * j)
    return potential, -potential * (3.0 * rr - radius * radius) * square


@inlined
def _capsule(
    p: tuple[Lane, Lane, Lane], p0: Vector3, p1: Vector3, radius: float
) -> tuple[Lane, Lane, Lane, Lane, Lane]:
    """Potential, gradient (3) and the distance from the axis segment."""
    ax, ay, az = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    over = 1.0 / length if length > 0.0 else 0.0 * length
    u = (ax * over, ay * over, az * over)
    dx, dy, dz = p[0] - p0[0], p[1] - p0[1], p[2] - p0[2]
    s = dx * u[0] + dy * u[1] + dz * u[2]
    excess = s - select(s < 0.0, 0.0 * s, select(s > length, length, s))
    wx, wy, wz = dx - s * u[0], dy - s * u[1], dz - s * u[2]
    square = wx * wx + wy * wy + wz * wz + excess * excess
    # So near that rounding would choose the direction, which then need not be across the axis.
    tolerance = _ON_AXIS if is_double(s) else _ON_AXIS_SINGLE
    on_axis = square <= tolerance * (dx * dx + dy * dy + dz * dz + length * length)
    vx, vy, vz = _across(u)
    wx, wy, wz = select(on_axis, vx, wx), select(on_axis, vy, wy), select(on_axis, vz, wz)
    used = select(on_axis, vx * vx + vy * vy + vz * vz, square)
    nearness = inverse_root(used)
    distance = used * nearness
    # Out to the shell, away from the nearest point of the axis.
    shell = (1.0 + CAPSULE_SHELL) * radius
    scale = select(on_axis | (distance < shell), shell * nearness, 1.0)
    s += (scale - 1.0) * excess
    wx, wy, wz = scale * wx, scale * wy, scale * wz
    across_square = wx * wx + wy * wy + wz * wz
    rr1 = s * s + across_square
    rr2 = (length - s) * (length - s) + across_square
    b2 = across_square - radius * radius
    b1 = s * s + b2
    b3 = (length - s) * (length - s) + b2
    i1 = inverse_root(b1)
    i2 = inverse_root(b3)
    tube, axial, radial = _tube(-s, length - s, b2, i1, i2, b1 * i1, b3 * i2, radius)
    cap1, slope1 = _half_sphere(rr1, i1, radius)
    cap2, slope2 = _half_sphere(rr2, i2, radius)
    across = radial + slope1 + slope2
    along = axial + slope1 * s + slope2 * (s - length)
    gx, gy, gz = across * wx + along * u[0], across * wy + along * u[1], across * wz + along * u[2]
    return tube + cap1 + cap2, gx, gy, gz, select(on_axis, 0.0, distance)


@inlined
def charged_capsule_at(p: Any, p0: Vector3, p1: Vector3, radius: float) -> Six:
    """Field of a capsule of unit charge per area at a point: `capsule_at`, curvature and winding number.

    The curvature is that of the law c/d with this potential and this slope, 2 |grad Phi|^2 / Phi, which the capsule
    follows near its surface; it is never negative.
    """
    potential, gx, gy, gz, distance = _capsule(p, p0, p1, radius)
    curvature = 2.0 * (gx * gx + gy * gy + gz * gz) / potential
    return potential, gx, gy, gz, curvature, winding_behind(distance - radius)


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
def sphere_at(p: Any, centre: Vector3, radius: float) -> Six:
    """Field of a sphere (a shell) of unit charge per area at a point.

    The potential is 4 pi a^2 / (r (r^2 - a^2)) outside and 4 pi a / (a^2 - r^2) inside, where the field is finite and
    pushes towards the centre, as that of a closed mesh does. The curvature is its second derivative along the radius,
    positive. The winding number is 1 inside, 1/2 on the sphere, else 0. On the sphere itself all are finite.

    Args:
        p: The point in the frame of the tables [m], numbers or lanes.
        centre: Of the sphere in that frame [m].
        radius: a [m].
    """
    dx, dy, dz = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    rr = dx * dx + dy * dy + dz * dz
    r = root(rr)
    aa = radius * radius
    outside = r >= radius
    far = select(outside, r, radius)
    over = 1.0 / (positive(r - radius) * (r + radius))
    inverse = 1.0 / far
    potential = 4.0 * math.pi * radius * over * (radius * inverse)
    square = inverse * inverse
    slope = potential * over * select(outside, -(3.0 - aa * square), 2.0)
    spread = select(outside, 12.0 * rr - 6.0 * aa + 2.0 * aa * aa * square, 2.0 * aa + 6.0 * rr)
    return potential, slope * dx, slope * dy, slope * dz, potential * (over * over) * spread, winding_behind(r - radius)


@inlined
def plane_at(p: Any, normal: Vector3, offset: float) -> Six:
    """Field of an infinite plane of unit charge per area at a point, the boundary of the half space behind it.

    The potential is 2 pi/h, h the distance from the plane, the curvature 4 pi/h^3. The winding number is that of the
    half space: 1 behind the plane, 1/2 on it, else 0. On the plane itself all are finite.
    """
    height = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset
    over = 1.0 / positive(height)
    potential = 2.0 * math.pi * over
    curvature = 2.0 * potential * (over * over)
    slope = -0.5 * curvature * height
    return potential, slope * normal[0], slope * normal[1], slope * normal[2], curvature, winding_behind(height)
