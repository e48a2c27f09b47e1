"""Names that Pinocchio or guidefield give themselves, and odd ones: a robot is the same under any of them."""

import itertools

import numpy as np
import pinocchio as pin
import pytest

from guidefield.engine import answer
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfText
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import lock_joints
from tests.robots import load, robot

PLAIN = ("w", "a", "b", "c", "d"), ("j1", "j2", "j3", "j4")
CLASHES = (
    "universe",
    "root_joint",
    "world",
    "a",
    "d",
    "a_0",
    "frame 0",
    "joint a",
    "#J00001#",
    "#L00000#",
    "tf#/",
    "time",
    "position:j1",
    "a.x",
    " ",
    " a b/c ",
    "ü/→",
    "../x",
    "${x}",
    "q" * 300,
)
KINDS = ("revolute", "prismatic", "fixed", "revolute")


def arm(links: tuple[str, ...], joints: tuple[str, ...]) -> UrdfText:
    """A chain of four joints, one of them fixed."""
    body = '<collision><origin xyz="0.1 0 0"/><geometry><box size="0.14 0.02 0.02"/></geometry></collision>'
    parts = [f'<link name="{link}">{body}</link>' for link in links]
    for k, (joint, kind) in enumerate(zip(joints, KINDS, strict=True)):
        parts.append(
            f'<joint name="{joint}" type="{kind}"><origin xyz="0.2 0 0.01" rpy="0.1 0 0.2"/><parent link="{links[k]}"/>'
            f'<child link="{links[k + 1]}"/><axis xyz="0 {k % 2} 1"/>'
            '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        )
    return UrdfText(text=f'<robot name="n">{"".join(parts)}</robot>')


def renamed(at: int, name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The plain names with one of them replaced: of a link, or of a joint."""
    links, joints = list(PLAIN[0]), list(PLAIN[1])
    if at < len(links):
        links[at] = name
    else:
        joints[at - len(links)] = name
    return tuple(links), tuple(joints)


RENAMED = [
    (at, name)
    for at, name in itertools.product(range(9), CLASHES)
    if name.strip() and name not in PLAIN[0 if at < 5 else 1]
]


@pytest.mark.parametrize("root", ["fixed", "planar", "free"])
def test_every_name_places_every_body_alike(root: str) -> None:
    """Wherever joints are locked: of the whole robot, of its first joint alone, and of its last alone."""
    plain = load(UrdfText(text=arm(*PLAIN).text, root_joint=root))
    for k, (at, name) in enumerate(RENAMED[::2] if root == "fixed" else RENAMED[::7]):
        links, joints = renamed(at, name)
        text = arm(links, joints).text
        if root != "fixed" and name == "root_joint" and at >= len(links):
            with pytest.raises(RobotInvalid, match="'root_joint' has the name of the joint by which robot"):
                load(UrdfText(text=text, root_joint=root))
            continue
        model = load(UrdfText(text=text, root_joint=root))
        assert set(model.links) == set(links)
        assert not any("yourdfpy" in warning for warning in model.warnings), (name, model.warnings)
        assert_alike(model, plain, links, joints, ({0}, {3}, {0, 1, 3})[k % 3])


def assert_alike(model, plain, links, joints, moving) -> None:
    groups = [
        select(
            one,
            [names[k] for k in sorted(moving)],
            None,
            one.rest,
            pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.ones(3)),
        )
        for one, names in ((model, joints), (plain, PLAIN[1]))
    ]
    z = np.linspace(0.3, 0.7, len(moving))
    for link, plain_link in zip(links, PLAIN[0], strict=True):
        found, right = (
            Kinematics(group).frame_placement(group.expand_from_local(z), group.robot.frame_id(name))
            for group, name in zip(groups, (link, plain_link), strict=True)
        )
        assert found.isApprox(right, 1e-12), (links, joints, moving, link)
    bodies = []
    for group, names in zip(groups, (links, PLAIN[0]), strict=True):
        data = group.model.createData()
        pin.forwardKinematics(group.model, data, group.expand_from_local(z))
        shapes = group.geometry.geometryObjects
        where = {
            group.robot.link_of_geometry(k): data.oMi[one.parentJoint] * one.placement for k, one in enumerate(shapes)
        }
        bodies.append([where[name].homogeneous for name in names])
        pairs = [
            frozenset(names.index(group.robot.link_of_geometry(k)) for k in (p.first, p.second))
            for p in group.geometry.collisionPairs
        ]
        bodies.append(sorted(map(sorted, pairs)))
    np.testing.assert_allclose(bodies[0], bodies[2], atol=1e-12)
    assert bodies[1] == bodies[3]


def test_a_locked_joint_called_universe_carries_its_link() -> None:
    """The link of a locked joint passes through a ball: no plan, no certificate, a contact."""
    ball = {
        "type": "sphere",
        "name": "ball",
        "radius": 0.05,
        "position": [0.2 + 0.5 * np.cos(1.2), 0.5 * np.sin(1.2), 0],
    }
    for name in ("j3", "universe"):
        links, joints = ("w", "a", "b", "c", "d"), ("j1", "j2", name, "j4")
        text = arm(links, joints).text.replace(' rpy="0.1 0 0.2"', "").replace("0.2 0 0.01", "0.2 0 0")
        text = (
            text.replace('type="prismatic"', 'type="revolute"')
            .replace('type="fixed"', 'type="revolute"')
            .replace("0 1 1", "0 0 1")
        )
        ask = {"robot": {"type": "urdf", "text": text}, "scene": {"name": "s", "obstacles": [ball]}}
        goal = {"type": "joints", "positions": {"j1": 1.5}}
        plan = answer({**ask, "group": ["j1"], "tip": "a", "start": {"j1": 0.9}, "goal": goal})
        judged = answer({**ask, "type": "certify", "path": [[0.9], [1.5]], "position_names": ["j1"]})
        assert (plan.status.name, judged.status.name) == ("PLANNING_FAILED", "INVALID_MOTION_PLAN"), name


@pytest.mark.parametrize(
    ("first", "second", "column"),
    [
        ('"base" type="planar"', '"base.x" type="revolute"', "base.x"),
        ('"base" type="planar"', '"base.wz" type="revolute"', "base.wz"),
        ('"base" type="floating"', '"base.qw" type="continuous"', "base.qw"),
        ('"base" type="floating"', '"base.vy" type="prismatic"', "base.vy"),
    ],
)
def test_joints_with_one_column_are_refused(first: str, second: str, column: str) -> None:
    joint = '<joint name={}><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/>{}</joint>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    body = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    text = f'<robot name="n"><link name="w"/><link name="p">{body}</link><link name="a"/>'
    text += joint.format(first, "w", "p", "") + joint.format(second, "p", "a", limit) + "</robot>"
    with pytest.raises(RobotInvalid, match=f"'base' and '{column}' would both have the column '{column}'"):
        load(UrdfText(text=text))


def test_a_joint_called_like_a_column_of_the_root_is_refused_where_the_root_moves() -> None:
    text = arm(PLAIN[0], ("root_joint.x", "j2", "j3", "j4")).text
    assert load(UrdfText(text=text)).joint("root_joint.x") is not None
    with pytest.raises(RobotInvalid, match=r"'root_joint' and 'root_joint\.x' would both have the column"):
        load(UrdfText(text=text, root_joint="planar"))


@pytest.mark.parametrize("name", ["panda", "talos_reduced", "kinova", "baxter"])
def test_locked_joints_are_where_pinocchio_has_them(name: str) -> None:
    """`pinocchio.buildReducedModel` is right for names that clash with nothing."""
    whole = robot(name)
    rng = np.random.default_rng(3)
    locked = sorted(
        rng.choice(np.arange(1, whole.model.njoints), (whole.model.njoints - 1) // 2, replace=False).tolist()
    )
    q = pin.integrate(whole.model, pin.neutral(whole.model), rng.uniform(-1, 1, whole.model.nv))
    ours, our_shapes = lock_joints(whole.model, whole.geometry, locked, q)
    theirs, their_shapes = pin.buildReducedModel(whole.model, whole.geometry, locked, q)
    assert list(ours.names) == list(theirs.names)
    at = pin.integrate(ours, pin.neutral(ours), rng.uniform(-1, 1, ours.nv))
    datas = [model.createData() for model in (ours, theirs)]
    for model, data in zip((ours, theirs), datas, strict=True):
        pin.framesForwardKinematics(model, data, at)
    for frame in whole.model.frames:
        if frame.type == pin.FrameType.BODY:
            index, other = (model.getFrameId(frame.name, pin.FrameType.BODY) for model in (ours, theirs))
            assert datas[0].oMf[index].isApprox(datas[1].oMf[other], 1e-12), frame.name
            assert ours.frames[index].name == whole.model.frames[index].name == frame.name, "frames keep their indices"
    for mine, other in zip(our_shapes.geometryObjects, their_shapes.geometryObjects, strict=True):
        assert mine.parentJoint == other.parentJoint
        assert mine.placement.isApprox(other.placement, 1e-12)
    pairs = [{(p.first, p.second) for p in shapes.collisionPairs} for shapes in (our_shapes, their_shapes)]
    assert pairs[0] == pairs[1]
    np.testing.assert_array_equal(ours.lowerPositionLimit, theirs.lowerPositionLimit)


@pytest.mark.parametrize("tip", ["b", "j2"])
def test_what_is_picked_up_with_a_joints_frame_is_held_by_the_link_below(tip: str) -> None:
    """The held ball meets a post where the second link carries it, whichever of its frames is the tip."""
    joint = (
        '<joint name="{}" type="revolute"><origin xyz="{} 0 0"/><parent link="{}"/><child link="{}"/>'
        '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
    )
    body = '<collision><origin xyz="0.1 0 0"/><geometry><box size="0.14 0.02 0.02"/></geometry></collision>'
    text = f'<robot name="n"><link name="w"/><link name="a">{body}</link><link name="b">{body}</link>'
    text += joint.format("j1", 0, "w", "a") + joint.format("j2", 0.2, "a", "b") + "</robot>"
    ball = {"type": "sphere", "name": "ball", "radius": 0.01, "position": [0.45, 0, 0]}
    place = [0.2 * np.cos(0.3) + 0.25 * np.cos(1.3), 0.2 * np.sin(0.3) + 0.25 * np.sin(1.3), 0.0]
    post = {"type": "sphere", "name": "post", "radius": 0.02, "position": place}
    take = {"goal": {"type": "joints", "positions": {"j1": 0.0, "j2": 0.0}}, "attach": {"object": "ball"}}
    carry = {"goal": {"type": "joints", "positions": {"j1": 0.3, "j2": 1.0}}}
    scene = {"name": "s", "obstacles": [ball, post]}
    ask = {"robot": {"type": "urdf", "text": text}, "scene": scene, "tip": tip, "start": {"j2": 0.5}}
    reply = answer({**ask, "steps": [take, carry]})
    assert reply.status.name != "SUCCESS"
    assert "ball and post" in reply.status.message
