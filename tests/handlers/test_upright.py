"""Bodies that stand exactly upright beside others that do: the verdict is that of their gap, whatever the kinds."""

import math
from typing import Any

import pytest

import guidefield

RADIUS, LENGTH = 0.033, 0.12
ANGLES = (-0.33533127740972213, 0.4780694861445931, -0.1358232305833449, -0.0069149781515260855)
"""Of four joints about parallel axes: they add up to nought but for rounding."""
TURN = 0.1064804688527452  # of the joint about the vertical axis, which turns on by `STEP` [rad]
STEP = 0.02

GEOMETRIES = {
    "cylinder": f'<cylinder radius="{RADIUS}" length="{LENGTH}"/>',
    "box": f'<box size="{2 * RADIUS} {2 * RADIUS} {LENGTH}"/>',
    "sphere": f'<sphere radius="{LENGTH / 2}"/>',
}
SHAPES = {
    "cylinder": {"type": "cylinder", "radius": RADIUS, "length": LENGTH},
    "capsule": {"type": "capsule", "radius": RADIUS, "length": LENGTH - 2 * RADIUS},
    "box": {"type": "box", "size": [2 * RADIUS, 2 * RADIUS, LENGTH]},
    "sphere": {"type": "sphere", "radius": LENGTH / 2},
}


def arm(geometry: str) -> dict[str, str]:
    """Five links of 0.3 m whose last carries a body about its frame's origin."""
    post = '<collision><origin xyz="0 0 0.5"/><geometry><sphere radius="0.01"/></geometry></collision>'
    text, parent = f'<robot name="arm"><link name="w">{post}</link>', "w"
    for index in range(5):
        body = f"<collision><geometry>{geometry}</geometry></collision>" if geometry and index == 4 else ""
        axis, x = ("0 0 1", 0.0) if index == 0 else ("0 1 0", 0.3)
        text += (
            f'<link name="l{index}">{body}</link><joint name="j{index}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{index}"/><origin xyz="{x} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-3.1" upper="3.1" velocity="1" effort="1"/></joint>'
        )
        parent = f"l{index}"
    return {"type": "urdf", "text": f"{text}</robot>"}


def place() -> tuple[float, float, float]:
    """Where the last link stands [m]."""
    pitches = [sum(ANGLES[: k + 1]) for k in range(3)]
    out = 0.3 + 0.3 * sum(map(math.cos, pitches))
    return out * math.cos(TURN), out * math.sin(TURN), -0.3 * sum(map(math.sin, pitches))


def obstacle(kind: str, gap: float) -> dict[str, Any]:
    """An obstacle that is a gap [m] below the body."""
    x, y, z = place()
    top = z - LENGTH / 2 - gap
    under = [x + 0.01, y + 0.005, top - 0.05]
    if kind == "box":
        return {"type": "box", "name": "o", "size": [0.6, 0.4, 0.1], "position": under}
    if kind == "cylinder":
        return {"type": "cylinder", "name": "o", "radius": 0.2, "length": 0.1, "position": under}
    if kind == "half_space":
        return {"type": "half_space", "name": "o", "normal": [0.0, 0.0, 1.0], "offset": top}
    corners = [[x - 0.3, y - 0.2, top], [x + 0.3, y - 0.2, top], [x + 0.3, y + 0.2, top], [x - 0.3, y + 0.2, top]]
    if kind == "polygon":
        return {"type": "polygon", "name": "o", "vertices": corners}
    vertices = [[*corner[:2], height] for height in (top - 0.1, top) for corner in corners]
    sides = [[i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    quads = [[3, 2, 1, 0], [4, 5, 6, 7], *sides]
    triangles = [[a, b, c] for a, b, c, _ in quads] + [[a, c, d] for a, _, c, d in quads]
    return {"type": "mesh", "name": "o", "vertices": vertices, "triangles": triangles}


def certify(robot: dict[str, str], one: dict[str, Any], **more: Any) -> Any:
    names = [f"j{index}" for index in range(5)]
    return guidefield.answer(
        {
            "type": "certify",
            "robot": robot,
            "scene": {"name": "s", "obstacles": [one]},
            "start": dict(zip(names, (TURN, *ANGLES), strict=True)),
            "position_names": ["j0"],
            "recording": "off",
            **({"path": [[TURN], [TURN + STEP]]} if "trajectory" not in more else {}),
            **more,
        }
    )


def check(reply: Any, gap: float, accuracy: float = 1e-5) -> None:
    """The verdict is that of a gap [m] all along, and so is the clearance, but where surfaces touch."""
    assert reply.status.name == ("SUCCESS" if gap > 0.0 else "INVALID_MOTION_PLAN"), reply.status.message
    if gap < 0.0:
        assert reply.certificate.reason == "contact"
    assert gap - accuracy <= reply.clearance.minimum <= max(gap, 0.0 if gap < 0.0 else gap) + accuracy


GAPS = (-0.003236081737274848, 0.006, -0.0005, 0.0005)


@pytest.mark.parametrize("kind", ["box", "cylinder", "half_space", "polygon", "mesh"])
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_an_upright_link_is_judged_by_its_gap(geometry: str, kind: str) -> None:
    for gap in GAPS:
        check(certify(arm(GEOMETRIES[geometry]), obstacle(kind, gap)), gap)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_upright_held_object_is_judged_by_its_gap(shape: str) -> None:
    held = {"obstacle": {**SHAPES[shape], "name": "can"}, "link": "l4"}
    for kind in ("box", "cylinder", "mesh"):
        for gap in GAPS:
            check(certify(arm(""), obstacle(kind, gap), attached_objects=[held]), gap)


def test_an_upright_link_is_judged_by_its_gap_to_what_moves() -> None:
    """An obstacle that sinks by a millimetre, or goes sideways."""
    for gap, shift, least in (
        (0.006, [0.0, 0.0, -0.001], 0.006),
        (0.006, [0.05, 0.0, 0.0], 0.006),
        (-0.003, [0.01, 0.0, 0.0], -0.003),
    ):
        one = obstacle("box", gap)
        placements = [
            {"position": one["position"]},
            {"position": [a + b for a, b in zip(one["position"], shift, strict=True)]},
        ]
        del one["position"]
        moving = {**one, "trajectory": {"times": [0.0, 1.0], "placements": placements}}
        check(
            certify(
                arm(GEOMETRIES["cylinder"]),
                moving,
                trajectory={"times": [0.0, 1.0], "positions": [[TURN], [TURN + STEP]]},
            ),
            least,
        )


def test_cylinders_side_by_side_keep_what_is_asked_for() -> None:
    """Two upright cylinders side by side, and a clearance that is asked for."""
    x, y, z = place()
    for gap, asked, status in (
        (0.02, 0.0199, "SUCCESS"),
        (0.02, 0.0201, "INVALID_MOTION_PLAN"),
        (-0.001, 0.0, "INVALID_MOTION_PLAN"),
    ):
        out = math.hypot(x, y)
        away = (out - 2 * RADIUS - gap) / out  # towards the axis that the arm turns about: nearest all along
        one = {"type": "cylinder", "name": "o", "radius": RADIUS, "length": 0.3, "position": [x * away, y * away, z]}
        reply = certify(arm(GEOMETRIES["cylinder"]), one, min_clearance=asked)
        assert reply.status.name == status, reply.status.message
        assert reply.clearance.minimum == pytest.approx(gap, abs=2e-6)
