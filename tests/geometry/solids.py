"""Bodies for the tests, and plain answers about them, by formulas that share no code with ours."""

import numpy as np

from guidefield.geometry import surfaces

Mesh = tuple[np.ndarray, np.ndarray]


def torus(large: float = 0.1, small: float = 0.03, around: int = 32, across: int = 16) -> Mesh:
    """A ring about z: neither convex nor a ball to a topologist."""
    u, v = np.meshgrid(2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij")
    rho = large + small * np.cos(v)
    vertices = np.stack([rho * np.cos(u), rho * np.sin(u), small * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    corner = (i * across + j).ravel()
    ahead = (((i + 1) % around) * across + j).ravel()
    above = (i * across + (j + 1) % across).ravel()
    both = (((i + 1) % around) * across + (j + 1) % across).ravel()
    return vertices, np.concatenate([np.column_stack([corner, ahead, both]), np.column_stack([corner, both, above])])


def channel() -> Mesh:
    """A U, 40 mm wide inside, 20 mm walls: closed and not convex."""
    outline = np.array([[0, 0], [80, 0], [80, 70], [60, 70], [60, 20], [20, 20], [20, 70], [0, 70]]) * 1e-3
    caps = np.array([[0, 1, 4], [1, 3, 4], [1, 2, 3], [0, 4, 5], [0, 5, 7], [5, 6, 7]])
    count = len(outline)
    vertices = np.vstack([np.column_stack([outline, np.full(count, z)]) for z in (0.0, 0.05)])
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    sides = [np.column_stack([here, after, after + count]), np.column_stack([here, after + count, here + count])]
    return vertices, np.vstack([caps[:, ::-1], caps + count, *sides])


def box(size: tuple[float, float, float], centre: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """A box."""
    made = surfaces.box(size)
    return made.vertices + np.array(centre), np.array(made.triangles)


def together(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return np.vstack([vertices for vertices, _ in meshes]), np.vstack(
        [triangles + start for (_, triangles), start in zip(meshes, first, strict=False)]
    )


def turned(mesh: Mesh) -> Mesh:
    """Inside out."""
    return mesh[0], mesh[1][:, ::-1].copy()


def hollow() -> Mesh:
    """A box with a box-shaped hollow."""
    return together(box((0.1, 0.12, 0.14)), turned(box((0.06, 0.05, 0.04), (0.005, 0.0, 0.01))))


def overlapping() -> Mesh:
    """Two boxes that share a part of their insides."""
    return together(box((0.1, 0.06, 0.06)), box((0.06, 0.1, 0.05), (0.05, 0.03, 0.0)))


def bowl() -> Mesh:
    """Half of a sphere's surface: open."""
    made = surfaces.sphere(0.08, 3)
    below = made.corners[:, :, 2].max(axis=1) < 0.02
    return made.vertices, made.triangles[below]


def cracked() -> Mesh:
    """A ball that lacks two triangles."""
    made = surfaces.sphere(0.06, 3)
    return made.vertices, np.array(made.triangles[2:])


def lying(mesh: Mesh, seed: int = 0) -> Mesh:
    """The same body turned and moved, so that nothing is along an axis."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return mesh[0] @ turn.T + rng.normal(size=3) * 0.3, mesh[1]


def on_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points spread over a surface; its vertices too."""
    corners = mesh[0][mesh[1]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(corners), count, p=areas / areas.sum())
    inner = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), count), corners[chosen])
    edges = corners[chosen, 0] + rng.random((count, 1)) * (corners[chosen, 1] - corners[chosen, 0])
    return np.vstack([inner, edges, mesh[0][np.unique(mesh[1])]])


def in_box_of(mesh: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points in the box about a mesh."""
    return rng.uniform(mesh[0].min(axis=0), mesh[0].max(axis=0), (count, 3))


def winding(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Winding numbers, from the triangles' solid angles (van Oosterom and Strackee)."""
    numbers = []
    for part in np.array_split(points, max(1, len(points) * len(mesh[1]) // 2_000_000)):
        a, b, c = np.moveaxis(mesh[0][mesh[1]][None] - part[:, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(arm, axis=2) for arm in (a, b, c))
        volume = np.einsum("nij,nij->ni", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nij,nij->ni", *arms) for arms in ((a, b), (b, c), (c, a)))
        angles = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        numbers.append(angles.sum(axis=1) / (4.0 * np.pi))
    return np.concatenate(numbers)


def distance(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Distances to the surface: over all triangles, the foot if it is inside, else the nearest of the edges."""
    best = []
    corners = mesh[0][mesh[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    for part in np.array_split(points, max(1, len(points) * len(corners) // 1_000_000)):
        within = np.tile(lengths > 0.0, (len(part), 1))
        squares = np.full((len(part), len(corners)), np.inf)
        for k in range(3):
            start, end = corners[:, k], corners[:, (k + 1) % 3]
            axis, offset = end - start, part[:, None] - start
            within &= np.einsum("nij,ij->ni", offset, np.cross(normals, axis)) >= 0.0
            share = np.clip(np.einsum("nij,ij->ni", offset, axis) / np.maximum((axis**2).sum(axis=1), 1e-300), 0, 1)
            squares = np.minimum(squares, ((offset - share[:, :, None] * axis) ** 2).sum(axis=2))
        heights = np.einsum("nij,ij->ni", part[:, None] - corners[:, 0], normals)
        squares = np.where(within, np.minimum(squares, heights**2), squares)
        best.append(np.sqrt(squares.min(axis=1)))
    return np.concatenate(best)


def in_balls(points: np.ndarray, balls: np.ndarray) -> np.ndarray:
    """Which points are in any ball."""
    return (np.linalg.norm(points[:, None] - balls[:, :3], axis=2) <= balls[:, 3]).any(axis=1)


def around(balls: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the surfaces of balls, shape (n, count, 3)."""
    directions = rng.normal(size=(len(balls), count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return balls[:, None, :3] + balls[:, None, 3:] * directions
