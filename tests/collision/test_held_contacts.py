"""A held object around a link that the planned joint can't move against it is in contact, to every request."""

import trimesh

import guidefield

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
