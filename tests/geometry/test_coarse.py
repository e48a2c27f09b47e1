"""Solids of fine meshes with fewer triangles: what is found with them holds for the meshes, by dense sampling."""

import functools

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.cover import cover
from guidefield.geometry.decomposition import decompose
from guidefield.geometry.primitive_covers import inner_balls
from guidefield.geometry.solid import CELL, WORTH, Solid, coarse_solid, solid
from tests.geometry import solids

BODIES = {
    "ring": solids.torus(0.02, 0.006, around=160, across=90),
    "plate": solids.together(solids.torus(0.02, 0.006, around=160, across=90), solids.box((0.03, 0.03, 0.0004))),
    "ball": tuple(surfaces.sphere(0.015, 5)),
}

bodies = pytest.mark.parametrize("name", BODIES)


@functools.cache
def coarse(name: str) -> tuple[solids.Mesh, Solid]:
    mesh = BODIES[name]
    body = coarse_solid(*mesh)
    assert body is not None
    return mesh, body


@bodies
def test_it_has_fewer_triangles_and_is_within_reach_of_the_mesh_both_ways(name: str) -> None:
    mesh, body = coarse(name)
    assert len(body.owners) <= WORTH * len(mesh[1])
    assert 0.0 < body.reach <= np.sqrt(3.0) * CELL
    fine = solid(*mesh)
    assert body.distances(solids.on_surface(mesh, 1500, np.random.default_rng(0))).max() <= body.reach + 1e-12
    back = solids.on_surface((body.surface.vertices, body.surface.triangles), 1500, np.random.default_rng(1))
    assert fine.distances(back).max() <= body.reach + 1e-12


@bodies
def test_what_is_further_from_both_is_inside_both_or_neither(name: str) -> None:
    mesh, body = coarse(name)
    points = solids.in_box_of(mesh, 1500, np.random.default_rng(2))
    exact, near = solid(*mesh).depths(points), body.depths(points)
    assert np.abs(exact - near)[np.minimum(np.abs(exact), np.abs(near)) > body.reach].max() <= body.reach + 1e-12


@bodies
def test_a_cover_contains_the_mesh_and_leaves_it_no_further_than_said(name: str) -> None:
    mesh, body = coarse(name)
    balls = cover(body, 0.012)
    assert balls.overhang <= 0.012
    rng = np.random.default_rng(3)
    assert solids.in_balls(solids.on_surface(mesh, 1500, rng), balls.spheres).all()
    fine, points = solid(*mesh), solids.in_box_of(mesh, 1500, rng)
    assert solids.in_balls(points[fine.depths(points) > 0.0], balls.spheres).all()
    around = solids.around(balls.spheres, 60, rng)
    beyond = (-fine.depths(around.reshape(-1, 3))).reshape(len(balls.spheres), -1).max(axis=1)
    assert (beyond <= balls.overhangs + 1e-12).all()
    assert (np.linalg.norm(mesh[0] - balls.bound[:3], axis=1) <= balls.bound[3]).all()


@bodies
def test_inner_balls_are_inside_the_mesh(name: str) -> None:
    mesh, body = coarse(name)
    inner = inner_balls(body)
    assert len(inner)
    assert (solid(*mesh).depths(inner[:, :3]) >= inner[:, 3]).all()


@bodies
def test_convex_parts_contain_the_mesh_and_stand_off_as_far_as_said(name: str) -> None:
    mesh, body = coarse(name)
    found, fine = decompose(body, 0.002, 4), solid(*mesh)
    rng = np.random.default_rng(4)
    points = solids.in_box_of(mesh, 1500, rng)
    points = np.vstack([points[fine.depths(points) > 0.0], solids.on_surface(mesh, 1500, rng)])
    heights = []
    for part in found.parts:
        corners = part.hull.corners
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        heights.append((points @ normals.T - np.einsum("ij,ij->i", normals, corners[:, 0])).max(axis=1))
        beyond = solids.on_surface((part.hull.vertices, part.hull.triangles), 400, rng)
        assert -fine.depths(beyond).min() <= part.stand_off
    assert np.min(heights, axis=0).max() <= 1e-9
