"""A drive through many rooms is optimised as a whole, and certified."""

import pytest

from guidefield import Box, JointsGoal, PlanRequest, Scene, UrdfText, answer

CART = """<robot name="cart"><link name="base"><collision><origin xyz="0 0 0.2"/><geometry>
<cylinder radius="0.28" length="0.36"/></geometry></collision></link></robot>"""

ROOM, DOOR, WIDTH = 6.0, 1.0, 6.0  # length of a room along the way, width of a door, and of a room across it [m]


def rooms(count: int) -> Scene:
    """Rooms in a row along x, with doors to either side in turn."""
    end = ROOM * count
    walls = {"left": (end, 0.1, end / 2, WIDTH / 2), "right": (end, 0.1, end / 2, -WIDTH / 2)}
    walls |= {f"end {x:.0f}": (0.1, WIDTH, x, 0.0) for x in (0.0, end)}
    for k in range(1, count):
        door = 1.8 if k % 2 else -1.8
        for name, low, high in (("right", -WIDTH / 2, door - DOOR / 2), ("left", door + DOOR / 2, WIDTH / 2)):
            walls[f"{name} of {k}"] = (0.1, high - low, ROOM * k, (low + high) / 2)
    return Scene(
        "rooms", obstacles=[Box(name=n, size=(a, b, 1.0), position=(x, y, 0.5)) for n, (a, b, x, y) in walls.items()]
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drive_of_48_metres_is_certified_as_it_was_optimised(seed: int) -> None:
    start, goal = ([x, 0.0, 0.0] for x in (ROOM / 2, ROOM * 7.5))
    reply = answer(
        PlanRequest(
            UrdfText(CART, root_joint="planar"),
            rooms(8),
            JointsGoal({"root_joint": goal}),
            start={"root_joint": start},
            guide_planes=[],
            allowed_planning_time=20.0,
            seed=seed,
        )
    )
    assert reply.status.name == "SUCCESS"
    assert reply.certificate.collision_free
    assert not [warning for warning in reply.warnings if "as it was found" in warning]
