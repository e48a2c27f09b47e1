"""Add trees over boxes, capsules and surfaces to the field's tables: multipole expansions for all that is far away.

The tables of a scene have trees over large meshes alone. For pictures of the field (`scene/field_slice.py`) among
thousands of boxes or polygons these are added; planning never reads them. Nodes, links and their depth-first order are
those of kernels/field. A larger `OPENING` is faster and less exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.field.box import AXES, CHARGE as BOX_CHARGE, HALVES
from guidefield.kernels.field.faces import (
    AFTER,
    BOXES,
    CAPSULES,
    FIRST_QUAD,
    FIRST_ROW,
    FIRST_TRIANGLE,
    FIRST_VERTEX,
    FORM,
    LINK_COLUMNS,
    PAST_QUAD,
    PAST_ROW,
    PAST_TRIANGLE,
)
from guidefield.kernels.field.field import (
    AREA,
    CAPSULE_CHARGE,
    CAPSULE_RADIUS,
    CHARGE,
    CHARGE_PER_AREA,
    MOMENTS,
    NODE_COLUMNS,
    OTHER_END,
    FieldTables,
    frozen,
)

LEAST = 64  # fewer things of a kind have no tree

OPENING = 0.35
"""Radius of a node over the distance from which its expansion is used: largest errors found among thousands of boxes,
capsules and polygons are 1e-2 of the potential, 1e-4 in the median."""

_UPPER = np.triu_indices(3)  # the second moments of a node: xx xy xz yy yz zz


@dataclass(frozen=True, eq=False)
class _Charged:
    """Charged things: centres of charge (n, 3) [m], charges [m^2], second moments about these (n, 3, 3) [m^4].

    Also area vectors of surfaces (n, 3) [m^2], 0 of what is closed, and radii of balls about them (n,) [m].
    """

    centres: Floats
    charges: Floats
    moments: Floats
    areas: Floats
    radii: Floats

    def reorder(self, order: Integers) -> _Charged:
        return _Charged(*(array[order] for array in vars(self).values()))


@dataclass(frozen=True, eq=False)
class _Tree:
    """Nodes in depth-first order.

    Of each the begin and end of the things below, the next node not below it, whether it is a leaf, row and reach.
    """

    begins: Integers
    ends: Integers
    after: Integers
    leaves: np.ndarray
    rows: Floats
    reach: Floats


def with_far_trees(tables: FieldTables) -> FieldTables:
    """Return the tables with trees over boxes, capsules and surfaces where there are many; see `OPENING`.

    Spheres and points of clouds take no longer than their trees do.
    """
    forms = {BOXES: ("boxes", _boxes), CAPSULES: ("capsules", _capsules)}
    parts, changed, first_form = [], {}, int(np.count_nonzero(tables.links[:, FORM] == 0))
    parts.append(_over_faces(tables, first_form))
    for index in range(first_form, len(tables.links)):
        form = int(tables.links[index, FORM])
        name, charged = forms.get(form, ("", None))
        if charged is None or tables.links[index, PAST_ROW] < LEAST:
            leaf = slice(index, index + 1)
            links = tables.links[leaf].copy()
            links[0, AFTER] = 1
            parts.append((tables.nodes[leaf], links, tables.reach[leaf]))
            continue
        rows = getattr(tables, name)
        things = charged(rows)
        order = curve_order(things.centres)
        tree = _tree(things.reorder(order))
        changed[name] = frozen(rows[order])
        links = np.zeros((len(tree.after), LINK_COLUMNS), np.int64)
        links[:, AFTER], links[:, FORM] = tree.after, form
        links[tree.leaves, FIRST_ROW], links[tree.leaves, PAST_ROW] = tree.begins[tree.leaves], tree.ends[tree.leaves]
        parts.append((tree.rows, links, tree.reach))
    firsts = np.cumsum([0, *(len(links) for _, links, _ in parts[:-1])])
    for first, (_, links, _) in zip(firsts.tolist(), parts, strict=True):
        links[:, AFTER] += first
    nodes, links, reach = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return tables._replace(nodes=frozen(nodes), links=frozen(links), reach=frozen(reach), **changed)


def _over_faces(tables: FieldTables, count: int) -> tuple[Floats, Integers, Floats]:
    """Return nodes, links and reach of the faces' trees, below trees over their roots if there are many."""
    nodes, links, reach = tables.nodes[:count].copy(), tables.links[:count].copy(), tables.reach[:count].copy()
    roots = np.array(list(_roots(links)), np.int64)
    if len(roots) < LEAST:
        return nodes, links, reach
    things = _surfaces(tables, links, roots)
    nodes[roots, :CHARGE_PER_AREA], reach[roots] = _rows(things)[:, :CHARGE_PER_AREA], things.radii / OPENING
    order = curve_order(things.centres)
    tree = _tree(things.reorder(order))
    sizes = (links[roots, AFTER] - roots)[order]
    # a leaf of that tree is a root itself, with all below it
    widths = np.where(tree.leaves, sizes[tree.begins], 1)
    places = np.cumsum([0, *widths])
    owner = np.repeat(np.arange(len(widths)), widths)
    first = roots[order[tree.begins]]
    source = first[owner] + np.arange(places[-1]) - places[owner]
    nodes, links, reach = nodes[source], links[source], reach[source]
    links[:, AFTER] += (places[:-1] - first)[owner]
    inner = ~tree.leaves
    above = places[:-1][inner]
    nodes[above], reach[above], links[above] = tree.rows[inner], tree.reach[inner], 0
    links[above, AFTER] = places[tree.after[inner]]
    return nodes, links, reach


def _roots(links: Integers) -> Iterator[int]:
    at = 0
    while at < len(links):
        yield at
        at = int(links[at, AFTER])


def _tree(things: _Charged) -> _Tree:
    begins: list[int] = []
    ends: list[int] = []
    after: list[int] = []

    def split(begin: int, end: int) -> None:
        at = len(begins)
        begins.append(begin)
        ends.append(end)
        after.append(0)
        if end - begin > 1:
            middle = (begin + end) // 2
            split(begin, middle)
            split(middle, end)
        after[at] = len(begins)

    split(0, len(things.charges))
    first, past = np.array(begins), np.array(ends)
    together = _together(things, first, past)
    return _Tree(
        begins=first,
        ends=past,
        after=np.array(after),
        leaves=past - first == 1,
        rows=_rows(together),
        reach=together.radii / OPENING,
    )


def _together(things: _Charged, begins: Integers, ends: Integers) -> _Charged:
    """Sum up runs of things, one thing each: from a begin up to an end, both of shape (m,)."""
    counts = ends - begins
    starts = np.cumsum(counts) - counts
    owner = np.repeat(np.arange(len(counts)), counts)
    index = begins[owner] + np.arange(len(owner)) - starts[owner]

    def sum_up(values: Floats) -> Floats:
        sums: Floats = np.add.reduceat(values[index], starts, axis=0)
        return sums

    weights = np.maximum(things.charges, 1e-30)
    centres = sum_up(weights[:, None] * things.centres) / sum_up(weights)[:, None]
    offsets = things.centres[index] - centres[owner]
    moments = sum_up(things.moments)
    moments += np.add.reduceat(
        things.charges[index, None, None] * offsets[:, :, None] * offsets[:, None], starts, axis=0
    )
    radii = np.maximum.reduceat(np.linalg.norm(offsets, axis=1) + things.radii[index], starts)
    return _Charged(centres, sum_up(things.charges), moments, sum_up(things.areas), radii)


def _rows(things: _Charged) -> Floats:
    rows = np.zeros((len(things.charges), NODE_COLUMNS))
    rows[:, :CHARGE], rows[:, CHARGE] = things.centres, things.charges
    rows[:, MOMENTS:AREA] = things.moments[:, _UPPER[0], _UPPER[1]]
    rows[:, AREA:CHARGE_PER_AREA] = things.areas
    return rows


def _boxes(rows: Floats) -> _Charged:
    a, b, c = 2.0 * rows[:, HALVES : HALVES + 3].T
    density = rows[:, BOX_CHARGE]
    faces = np.stack([b * c, a * c, a * b], axis=1)
    squares = np.stack([a, b, c], axis=1) ** 2
    along = squares * (0.5 * faces + (faces.sum(axis=1, keepdims=True) - faces) / 6.0)
    axes = rows[:, AXES:HALVES].reshape(-1, 3, 3)
    moments = np.einsum("n,nki,nk,nkj->nij", density, axes, along, axes)
    radii = 0.5 * np.sqrt(squares.sum(axis=1))
    return _Charged(rows[:, :3], 2.0 * density * faces.sum(axis=1), moments, np.zeros((len(rows), 3)), radii)


def _capsules(rows: Floats) -> _Charged:
    first, second, radii = rows[:, :3], rows[:, OTHER_END : OTHER_END + 3], rows[:, CAPSULE_RADIUS]
    axes, density = second - first, rows[:, CAPSULE_CHARGE]
    half = 0.5 * np.linalg.norm(axes, axis=1)
    units = axes / np.maximum(2.0 * half, 1e-30)[:, None]
    side, caps = 4.0 * np.pi * radii * half, 4.0 * np.pi * radii**2
    along = side * half**2 / 3.0 + caps * (half**2 + half * radii + radii**2 / 3.0)
    across = 0.5 * side * radii**2 + caps * radii**2 / 3.0
    moments = across[:, None, None] * np.eye(3)
    moments += (along - across)[:, None, None] * units[:, :, None] * units[:, None]
    moments *= density[:, None, None]
    return _Charged(0.5 * (first + second), density * (side + caps), moments, np.zeros_like(axes), half + radii)


def _surfaces(tables: FieldTables, links: Integers, roots: Integers) -> _Charged:
    corners, density, owners = [], [], []
    root_of = np.repeat(np.arange(len(roots)), links[roots, AFTER] - roots)
    for first, past, table, halves in (
        (FIRST_TRIANGLE, PAST_TRIANGLE, tables.triangle_corners, ((0, 1, 2),)),
        (FIRST_QUAD, PAST_QUAD, tables.quad_corners, ((0, 1, 2), (3, 4, 5))),
    ):
        counts = links[:, past] - links[:, first]
        leaf = np.repeat(np.arange(len(links)), counts)  # faces stand in the order of the leaves
        for half in halves:
            corners.append(tables.vertices[links[leaf, FIRST_VERTEX, None] + table[:, half]])
            density.append(tables.nodes[leaf, CHARGE_PER_AREA])
            owners.append(root_of[leaf])
    v, owner = np.concatenate(corners), np.concatenate(owners)
    across = 0.5 * np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    areas = np.linalg.norm(across, axis=1)
    charges = areas * np.concatenate(density)
    centres = v.mean(axis=1)
    offsets = v - centres[:, None]
    moments = np.einsum("n,nki,nkj->nij", charges / 12.0, offsets, offsets)
    radii = np.linalg.norm(offsets, axis=2).max(axis=1)
    order = np.argsort(owner, kind="stable")
    ends = np.cumsum(np.bincount(owner, minlength=len(roots)))
    faces = _Charged(centres, charges, moments, across, radii).reorder(order)
    return _together(faces, np.r_[0, ends[:-1]], ends)
