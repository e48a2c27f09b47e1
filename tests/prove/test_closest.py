"""Clearance and contact at many configurations are those of one after the other; gradients against differences."""

import numpy as np
import pytest

import guidefield
from guidefield.collision.clearance import clearance_at, clearance_gradient
from guidefield.collision.world import World
from guidefield.handlers.configurations import whole_group
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.prove.closest import ClosestPairs
from guidefield.scene import scene as scenes
from guidefield.stores.scenes import read_packaged
from tests.robots import robot


def world_of(name: str, scene: str) -> World:
    return World.build(whole_group(robot(name), Placement((0.1, 0.2, 0.0))), scenes.build(read_packaged(scene)))


def random_configurations(world: World, count: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.array([world.group.expand(world.group.random(rng)) for _ in range(count)])


class TestClosestPairs:
    @pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf"), ("ur5", "table"), ("kinova", "bookshelf")])
    def test_they_are_those_of_one_after_the_other(self, name: str, scene: str):
        world = world_of(name, scene)
        qs = random_configurations(world, 60)
        free = ClosestPairs(world).free(qs)
        for q, one, is_free in zip(qs, ClosestPairs(world).clearances(qs), free, strict=True):
            alone = clearance_at(world, q)
            assert one.obstacle_distance == pytest.approx(alone.obstacle_distance, abs=1e-6)
            assert one.self_distance == pytest.approx(alone.self_distance, abs=1e-6)
            assert is_free == (not world.in_collision(q))
        assert 0 < free.sum() < len(qs)

    def test_obstacles_that_move_are_measured_where_they_begin(self):
        world = world_of("panda", "door")
        qs = random_configurations(world, 5)
        for q, one in zip(qs, ClosestPairs(world).clearances(qs), strict=True):
            assert one.obstacle_distance == clearance_at(world, q).obstacle_distance

    def test_a_body_inside_a_closed_mesh_is_not_free(self):
        corners = [(x, y, z) for x in (-5.0, 5.0) for y in (-5.0, 5.0) for z in (-5.0, 5.0)]
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        triangles = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
        hall = messages.Mesh("hall", vertices=corners, triangles=triangles)
        dent = messages.Mesh(
            "dent",
            vertices=[*corners, (0.0, 0.0, 4.0)],
            triangles=[*triangles[:-2], (1, 5, 8), (5, 7, 8), (7, 3, 8), (3, 1, 8)],
        )
        for mesh in (hall, dent):
            scene = scenes.build(messages.Scene("s", obstacles=[mesh]))
            world = World.build(whole_group(robot("panda"), Placement()), scene)
            assert not ClosestPairs(world).free(random_configurations(world, 3)).any()
        world = World.build(whole_group(robot("ur5"), Placement()), scene)
        found = list(ClosestPairs(world).clearances(random_configurations(world, 60)))
        assert min(one.self_distance for one in found) <= 0.0 < max(one.self_distance for one in found)
        assert {one.obstacle_distance for one in found} == {0.0}, "also where the robot touches itself"


class TestGradient:
    @pytest.mark.parametrize("name", ["panda", "ur5", "allegro_right_hand"])
    def test_it_is_what_differences_say(self, name: str):
        world, h, compared = world_of(name, "bookshelf"), 1e-6, 0
        group = world.group
        for q in random_configurations(world, 12):
            one = clearance_at(world, q)
            for own in (True, False):
                distance = one.self_distance if own else one.obstacle_distance
                if not 1e-3 < distance < 10.0:
                    continue
                gradient = clearance_gradient(world, q, one, own=own)
                z = group.to_local(group.part_of(q))
                for column in range(group.nv):
                    step = h * np.eye(group.nv)[column]
                    ends = [clearance_at(world, group.expand_from_local(z + s * step)) for s in (1.0, -1.0)]
                    there, back = (e.self_distance if own else e.obstacle_distance for e in ends)
                    forward, backward = (there - distance) / h, (distance - back) / h
                    if abs(forward - backward) < 1e-3:  # where the closest pair changes there is no derivative
                        compared += 1
                        assert gradient[column] == pytest.approx((there - back) / (2 * h), abs=2e-3)
        assert compared > 20

    def test_through_the_door(self):
        request = {
            "type": "clearance",
            "robot": "panda",
            "scene": "bookshelf",
            "configurations": [{"panda_joint2": 0.1 * i, "panda_joint4": -1.5} for i in range(4)],
            "gradients": True,
        }
        reply = guidefield.answer(request)
        packed = guidefield.answer({**request, "packed": True}).packed
        numbers = {
            field: np.frombuffer(getattr(packed, field).float64).reshape(getattr(packed, field).shape)
            for field in ("minimum", "self_minimum", "witness_points", "pair", "gradient", "self_gradient")
        }
        assert numbers["minimum"].tolist() == reply.minimum
        assert numbers["self_minimum"].tolist() == reply.self_minimum
        assert numbers["gradient"].tolist() == reply.gradient
        assert numbers["self_gradient"].tolist() == reply.self_gradient
        assert [packed.pairs[int(index)] for index in numbers["pair"]] == reply.pair
        assert numbers["witness_points"].tolist() == [[list(p) for p in two] for two in reply.witness_points]
        assert len(reply.velocity_names) == len(reply.gradient[0])
        assert guidefield.answer({**request, "gradients": False, "verdict": True}).free == [
            x > 0 for x in reply.minimum
        ]
