"""Contact at a configuration, against Coal's distance pair by pair; which pairs there are."""

import dataclasses

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.blocking_pairs import contacts_at
from guidefield.collision.world import World
from guidefield.errors import SceneInvalid, UnknownObject
from guidefield.messages import scene as messages
from guidefield.robot.group.reduced_model import select
from tests.collision.listed import are_mixed, geometry_of, listed, touching as touching_in
from tests.collision.scenery import box, panda_in, scattered, world_of
from tests.robots import box_arm, group, grouped, random_configuration, rest, robot
from tests.scene.solids import l_prism, mesh_message

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


@settings(deadline=None, max_examples=18)
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
        assert answers[-1] == bool(touching_in(world, q))
    assert len(set(answers)) == 2


def _shrunk(obstacle):
    if isinstance(obstacle, messages.Box):
        return box(obstacle.name, np.array(obstacle.size) * 0.2, obstacle.position)
    return messages.Sphere(name=obstacle.name, radius=0.2 * obstacle.radius, position=obstacle.position)


def test_pairs_are_own_ones_then_moving_links_with_obstacles():
    world = panda_in("bookshelf")
    planned = world.group
    joints = [shape.parentJoint for shape in geometry_of(world).geometryObjects]
    moving = sum(shape.parentJoint != 0 for shape in planned.geometry.geometryObjects)
    assert world.pairs.n_self == len(planned.geometry.collisionPairs)
    assert len(world.pairs) == world.pairs.n_self + moving * len(world.scene.obstacles)
    assert (listed(world)[:, 0] < listed(world)[:, 1]).all()
    assert are_mixed(world).tolist() == [k >= world.pairs.n_self for k in range(len(world.pairs))]
    for k, (a, b) in enumerate(listed(world).tolist()):
        assert joints[a] != joints[b]
        assert world.pair_names(k)[0] in planned.robot.links
        names = (
            [obstacle.name for obstacle in world.scene.obstacles] if k >= world.pairs.n_self else planned.robot.links
        )
        assert world.pair_names(k)[1] in names
    assert "panda_link0" not in {world.pair_names(k)[0] for k in range(world.pairs.n_self, len(world.pairs))}


def test_links_that_the_group_holds_still_are_not_tested():
    model = robot("panda")
    forearm = select(model, ["panda_joint5", "panda_joint6", "panda_joint7"], None, model.rest, pin.SE3.Identity())
    world = world_of(forearm, [box("crate", (0.3, 0.3, 0.3), (0, 0, 0.15))])
    names = {world.pair_names(k)[0] for k in range(world.pairs.n_self, len(world.pairs))}
    assert names.isdisjoint({f"panda_link{i}" for i in range(5)})
    assert not world.in_collision(rest(forearm))
    joints = [shape.parentJoint for shape in geometry_of(world).geometryObjects]
    assert all(joints[a] != joints[b] for a, b in listed(world).tolist())


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


def test_unknown_names_list_those_there_are():
    with pytest.raises(UnknownObject, match="can3") as caught:
        world_of(
            group("panda"),
            [box("crate", (0.1, 0.1, 0.1), (1, 0, 0))],
            [("panda_hand", "crate"), ("panda_hand", "can3")],
        )
    assert caught.value.details["obstacles"] == ["crate"]
    assert "panda_hand" in caught.value.details["links"]


def test_an_obstacle_may_have_the_name_of_a_body_of_another():
    world = world_of(group("panda"), [box("panda_link0_0", (0.1, 0.1, 0.1), (0.307, 0, 0.6))])
    assert world.in_collision(rest(world.group))


def test_a_world_without_obstacles_or_own_pairs_is_free():
    arm = grouped(box_arm("y", 1))
    empty = dataclasses.replace(arm, geometry=arm.geometry.copy())
    empty.geometry.removeAllCollisionPairs()
    world = world_of(empty, [])
    q = np.zeros(empty.nq)
    assert len(world.pairs) == 0
    assert not world.in_collision(q)
    assert contacts_at(world, q) == []


def test_a_surface_in_contact_has_no_depth():
    arm = group("panda")
    vertices, triangles = l_prism()
    shelf = mesh_message(0.1 * vertices, triangles, position=(0.25, -0.05, 0.55))
    contacts = contacts_at(world_of(arm, [shelf]), rest(arm))
    assert contacts
    assert {contact.depth for contact in contacts} == {None}


@pytest.mark.parametrize("name", ["bookshelf", "room of triangles"])
def test_pairs_of_some_bodies_are_found_alone(name):
    planned = group("panda")
    world = (
        panda_in(name) if name in SCENES else world_of(planned, [mesh_message(*l_prism(), position=(0.0, -0.5, 0.0))])
    )
    rng = np.random.default_rng(5)
    qs = [planned.expand_from_chart(rng.uniform(planned.lower, planned.upper)) for _ in range(30)]
    some = np.arange(world.pairs.links) % 3 == 1
    kept = [
        [
            pair
            for pair in pairs
            if any(body < len(some) and some[body] for body in world.pairs.of(pair))
            or (pair >= world.pairs.n_self and not world.scene.convex)
        ]
        for pairs in world.near_each(qs)
    ]
    assert world.near_each(qs, some) == kept
    assert 0 < sum(map(len, kept)) < sum(map(len, world.near_each(qs)))
