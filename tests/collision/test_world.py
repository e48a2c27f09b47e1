"""Contact at a configuration, against Coal pair by pair; near pairs against all of them; held objects."""

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

import guidefield
from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World, _link_shapes
from guidefield.errors import SceneInvalid
from guidefield.memo import size_of
from guidefield.messages import scene as messages
from tests.collision.plain import geometry_of, listed, touching
from tests.collision.scenery import box, panda_in, scattered, world_of
from tests.robots import group, random_configuration, rest

SCENES = ("bookshelf", "table", "wall_with_window", "seed_b_tapered")
seeds = st.integers(0, 10**6)


def pair_distances(world: World, q: np.ndarray) -> np.ndarray:
    """Coal's distance of each pair, with transforms from a forward kinematics of its own."""
    data = world.model.createData()
    pin.forwardKinematics(world.model, data, world.group.expand(q))
    transforms, shapes = [], []
    for shape in geometry_of(world).geometryObjects:
        placed = data.oMi[shape.parentJoint] * shape.placement
        transforms.append(coal.Transform3s(placed.rotation, placed.translation))
        shapes.append(shape.geometry)
    request = coal.DistanceRequest()
    return np.array(
        [
            coal.distance(shapes[a], transforms[a], shapes[b], transforms[b], request, coal.DistanceResult())
            for a, b in listed(world).tolist()
        ]
    )


@settings(max_examples=18)
@given(st.sampled_from(SCENES), seeds)
def test_contact_is_what_coal_says_pair_by_pair(name, seed):
    world = panda_in(name)
    q = random_configuration(world.group, seed)
    distances = pair_distances(world, q)
    close = np.abs(distances) < 1e-6
    if close.any():
        return
    assert world.in_collision(q) == (distances < 0.0).any() | (distances == 0.0).any()
    touching = {world.pair_names(k) for k in np.flatnonzero(distances <= 0.0)}
    contacts = contacts_at(world, q)
    assert {contact.pair for contact in contacts} == touching
    depths = {k: -distances[k] for k in np.flatnonzero(distances <= 0.0)}
    for contact, (pair, depth) in zip(contacts, depths.items(), strict=True):
        assert contact.pair == world.pair_names(pair)
        assert (
            contact.depth is None if not world.is_signed(int(pair)) else contact.depth == pytest.approx(depth, abs=1e-6)
        )


@pytest.mark.parametrize("seed", [0])
def test_many_bodies_and_a_slanted_half_space_change_nothing(seed):
    rng = np.random.default_rng(seed)
    slope = messages.HalfSpace(name="slope", normal=(0.3, -0.2, 1.0), offset=-0.05)
    obstacles = [*scattered(rng, 270, reach=1.3), slope]
    obstacles = [o if o is slope else _shrunk(o) for o in obstacles]
    world = world_of(group("panda"), obstacles)
    answers = []
    for _ in range(40):
        q = world.group.random(rng)
        answers.append(world.in_collision(q))
        assert answers[-1] == bool(touching(world, q))
    assert len(set(answers)) == 2


def _shrunk(obstacle):
    if isinstance(obstacle, messages.Box):
        return box(obstacle.name, np.array(obstacle.size) * 0.2, obstacle.position)
    return messages.Sphere(name=obstacle.name, radius=0.2 * obstacle.radius, position=obstacle.position)


def test_allowed_collisions_are_left_out():
    crate = box("crate", (0.1, 0.1, 0.1), (0.307, 0, 0.6))
    arm = group("panda")
    touching = {contact.pair for contact in contacts_at(world_of(arm, [crate]), rest(arm))}
    assert touching
    world = world_of(arm, [crate], [(b, a) for a, b in touching])
    assert not world.in_collision(rest(arm))
    assert touching.isdisjoint({world.pair_names(k) for k in range(len(world.pairs))})
    own = world.pair_names(0)
    without = world_of(arm, [crate], [own])
    assert without.pairs.n_self < world.pairs.n_self
    assert own not in {without.pair_names(k) for k in range(without.pairs.n_self)}


def test_an_obstacle_with_the_name_of_a_link_is_refused():
    crate = box("panda_link3", (0.1, 0.1, 0.1), (0.307, 0, 0.6))
    for allowed in ([], [("panda_link3", "panda_link5")]):
        with pytest.raises(SceneInvalid, match=r"obstacle 'panda_link3' has the name of a link") as caught:
            world_of(group("panda"), [box("far", (0.1, 0.1, 0.1), (3, 0, 0)), crate], allowed)
        assert caught.value.details["path"] == "$.scene.obstacles[1].name"


def test_shapes_that_are_the_robots_own_count_for_no_memory_of_results():
    shapes = _link_shapes(group("ur5"))  # meshes
    assert size_of(shapes.each) > 10**6
    assert size_of(shapes) == 0


FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.4)


@pytest.mark.parametrize("seed", range(3))
def test_among_hundreds_of_obstacles_answers_are_those_of_all_pairs(seed):
    rng = np.random.default_rng(seed)
    crumbs = [
        box(f"c{k}", rng.uniform(0.01, 0.03, 3), p) for k, p in enumerate(rng.uniform(-1.2, 1.2, (400, 3)).tolist())
    ]
    world = world_of(group("panda"), [*crumbs, FLOOR], [("panda_link3", "c7"), ("panda_hand", "floor")])
    for _ in range(4):
        q = world.group.expand(world.group.random(rng))
        expected = touching(world, q)
        assert [k for k in world.near(q) if world.touches(k)] == expected
        assert world.in_collision(q) == bool(expected)
        distances = pair_distances(world, q)
        assert clearance_at(world, q).obstacle_distance == pytest.approx(
            distances[world.pairs.n_self :].min(), abs=2e-6
        )


CART = """<robot name="cart"><link name="w"/>
<link name="a"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link><link name="m"/>
<link name="b"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="w"/><child link="a"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="f" type="fixed"><parent link="a"/><child link="m"/><origin xyz="0 0 0.3"/></joint>
<joint name="y" type="prismatic"><parent link="m"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"""


def judged(bore: float, offset: float) -> tuple[bool, bool, bool]:
    """Whether a held ring is free to `clearance`, `certify` and a plan of the joint that carries it and the link."""
    ring = trimesh.creation.annulus(bore, 0.6, 0.5, sections=12)
    shape = {"type": "mesh", "name": "h", "vertices": ring.vertices.tolist(), "triangles": ring.faces.tolist()}
    common = {
        "robot": {"type": "urdf", "text": CART},
        "scene": {"name": "empty", "obstacles": []},
        "attached_objects": [{"obstacle": shape, "link": "b", "placement": {"position": [offset, 0.0, -0.3]}}],
    }
    still = {"x": 0.0, "y": 0.0}
    free = guidefield.answer({"type": "clearance", **common, "configurations": [still], "verdict": True}).free
    motion = {"start": still, "path": [[0.0], [0.001]], "position_names": ["x"]}
    certified = guidefield.answer({"type": "certify", **common, **motion})
    goal = {"type": "joints", "positions": {"x": 0.001}}
    plan = guidefield.answer({**common, "start": still, "group": ["x"], "goal": goal})
    return free[0], certified.status.name == "SUCCESS", plan.status.name == "SUCCESS"


def test_a_link_in_the_wall_of_a_held_ring():
    assert judged(0.2, 0.4) == (False, False, False)


def test_a_link_in_the_bore_of_a_held_ring():
    assert judged(0.2, 0.0) == (True, True, True)
