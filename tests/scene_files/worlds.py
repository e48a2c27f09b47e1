"""One world of five shapes, in every format that has placements and primitives."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from guidefield.messages.scene import Box, Cylinder, Mesh, Obstacle, Scene, Sphere

WEDGE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def placement(seed: int) -> pin.SE3:
    rng = np.random.default_rng(seed)
    turn = pin.Quaternion(*(rng.normal(size=4) + 0.1)).normalized()
    return pin.SE3(turn.matrix(), rng.uniform(0.3, 0.9, 3))


PLACES = {name: placement(seed) for seed, name in enumerate(("board", "can", "ball", "post", "wedge"))}


def words(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def quaternion(place: pin.SE3) -> np.ndarray:
    """Its quaternion x, y, z, w, shape (4,)."""
    return np.array(pin.Quaternion(place.rotation).coeffs())


def reference() -> Scene:
    """The world as primitives and a mesh."""

    def at(name: str) -> dict[str, object]:
        place = PLACES[name]
        return {"position": tuple(place.translation), "quaternion_xyzw": tuple(quaternion(place))}

    obstacles: list[Obstacle] = [
        Box(name="board", size=(0.4, 0.2, 0.05), **at("board")),
        Cylinder(name="can", radius=0.05, length=0.3, **at("can")),
        Sphere(name="ball", radius=0.1, position=tuple(PLACES["ball"].translation)),
        Box(name="post", size=(0.1, 0.1, 0.9), **at("post")),
        Mesh(name="wedge", vertices=WEDGE.tolist(), triangles=TRIANGLES.tolist(), **at("wedge")),
    ]
    return Scene(name="world", obstacles=obstacles)


def stl(folder: Path) -> str:
    """Write the wedge beside a world, as text with all digits, and return its name."""
    corners = ["".join(f"vertex {words(WEDGE[k])}\n" for k in one) for one in TRIANGLES]
    facets = "".join(f"facet normal 0 0 0\nouter loop\n{three}endloop\nendfacet\n" for three in corners)
    (folder / "wedge.stl").write_text(f"solid wedge\n{facets}endsolid\n")
    return "wedge.stl"


def moveit(folder: Path, posed: bool = True) -> bytes:
    """MoveIt's form with a pose of each object, or the one before it."""
    mesh = f"mesh\n{len(WEDGE)} {len(TRIANGLES)}\n" + "".join(f"{words(row)}\n" for row in WEDGE)
    mesh += "".join(f"{' '.join(map(str, row))}\n" for row in TRIANGLES.tolist())
    shapes = {
        "board": "box\n0.4 0.2 0.05\n",
        "can": "cylinder\n0.05 0.3\n",
        "ball": "sphere\n0.1\n",
        "post": "box\n0.1 0.1 0.9\n",
        "wedge": mesh,
    }
    text = "(noname)+++\n"
    for name, shape in shapes.items():
        whole = PLACES[name]
        own = placement(50) if posed else pin.SE3.Identity()
        local = own.inverse() * whole
        head, tail = (f"{_lines(own)}", "1\ngrasp\n0 0 0\n0 0 0 1\n") if posed else ("", "")
        text += f"* {name}\n{head}1\n{shape}{_lines(local)}0 0 0 0\n{tail}"
    return (text + ".\n").encode()


def _lines(place: pin.SE3) -> str:
    return f"{words(place.translation)}\n{words(quaternion(place))}\n"


def urdf(folder: Path) -> bytes:
    """A link for each, some below others, and a joint that is at rest elsewhere than at 0."""
    shapes = {
        "board": '<box size="0.4 0.2 0.05"/>',
        "can": '<cylinder radius="0.05" length="0.3"/>',
        "ball": '<sphere radius="0.1"/>',
        "post": '<box size="0.1 0.1 0.9"/>',
        "wedge": f'<mesh filename="{stl(folder)}"/>',
    }
    text, below, at = '<link name="root"/>', "root", pin.SE3.Identity()
    for name, shape in shapes.items():
        local = at.inverse() * PLACES[name]
        text += f'<link name="{name}"><collision><geometry>{shape}</geometry></collision></link>'
        text += f'<joint name="{name}_joint" type="fixed"><parent link="{below}"/><child link="{name}"/>'
        text += f'<origin xyz="{words(local.translation)}" quat_xyzw="{words(quaternion(local))}"/></joint>'
        below, at = name, PLACES[name]
    return f'<robot name="world" version="1.1">{text}</robot>'.encode()


def mjcf(folder: Path) -> bytes:
    """A body for each, some within others."""
    text, at = "", pin.SE3.Identity()
    sizes = {
        "board": 'type="box" size=".2 .1 .025"',
        "can": 'type="cylinder" size=".05 .15"',
        "ball": 'type="sphere" size=".1"',
        "post": 'type="box" size=".05 .05 .45"',
        "wedge": 'type="mesh" mesh="wedge"',
    }
    for name, size in sizes.items():
        local = at.inverse() * PLACES[name]
        x, y, z, w = quaternion(local)
        text += f'<body name="{name}" pos="{words(local.translation)}" quat="{words((w, x, y, z))}"><geom {size}/>'
        at = PLACES[name]
    mesh = f'<mesh name="wedge" vertex="{words(WEDGE)}" face="{" ".join(map(str, TRIANGLES.ravel()))}"/>'
    return f"<mujoco><asset>{mesh}</asset><worldbody>{text}{'</body>' * len(sizes)}</worldbody></mujoco>".encode()


def sdf(folder: Path) -> bytes:
    """Poses in frames of every kind: of the world, of a model, of a joint, of a nested model, by a placement frame."""
    frame, hinge, inner, shift = (placement(seed) for seed in (60, 61, 62, 63))

    def pose(place: pin.SE3, relative_to: str = "") -> str:
        said = f' relative_to="{relative_to}"' if relative_to else ""
        return f"<pose{said}>{words(place.translation)} {words(pin.rpy.matrixToRpy(place.rotation))}</pose>"

    def link(name: str, place: str, shape: str) -> str:
        geometry = f"<geometry>{shape}</geometry>"
        return f'<link name="{name}">{place}<collision name="hull">{geometry}</collision></link>'

    board = link("board", "", "<box><size>0.4 0.2 0.05</size></box>")
    can = link("can", pose(hinge.inverse() * frame.inverse() * PLACES["can"], "hinge"), CAN)
    ball = link("ball", pose(inner.inverse() * frame.inverse() * PLACES["ball"], "deep::inner"), BALL)
    deep = f'<model name="deep">{pose(pin.SE3.Identity())}<frame name="inner">{pose(inner)}</frame></model>'
    joint = (
        f'<joint name="hinge" type="fixed">{pose(hinge, "__model__")}<parent>world</parent><child>can</child></joint>'
    )
    place = PLACES["post"] * shift
    post = link("post", "", "<box><size>0.1 0.1 0.9</size></box>") + f'<frame name="grip">{pose(shift)}</frame>'
    (folder / "models" / "wedge").mkdir(parents=True)
    wedge = link("wedge", "", f"<mesh><uri>{stl(folder / 'models' / 'wedge')}</uri></mesh>")
    model = f'<sdf version="1.9"><model name="any">{pose(placement(64))}{wedge}</model></sdf>'
    (folder / "models" / "wedge" / "wedge.sdf").write_text(model)
    config = '<model><sdf version="1.4">old.sdf</sdf><sdf version="1.10">wedge.sdf</sdf></model>'
    (folder / "models" / "wedge" / "model.config").write_text(config)
    return f"""<sdf version="1.9"><world name="w"><light name="sun" type="directional"/><plugin filename="a" name="b"/>
      <frame name="desk">{pose(frame)}</frame>
      <model name="board">{pose(frame.inverse() * PLACES["board"], "desk")}{board}</model>
      <model name="arm">{pose(frame)}{joint}{can}{ball}{deep}</model>
      <model name="post" placement_frame="grip">{pose(place)}{post}</model>
      <include><uri>model://wedge</uri><name>wedge</name>{pose(frame.inverse() * PLACES["wedge"], "desk")}</include>
      </world></sdf>""".encode()


CAN = "<cylinder><radius>0.05</radius><length>0.3</length></cylinder>"
BALL = "<sphere><radius>0.1</radius></sphere>"

WRITERS: dict[str, tuple[str, Callable[[Path], bytes]]] = {
    "moveit": (".scene", moveit),
    "moveit of before": (".scene", lambda folder: moveit(folder, posed=False)),
    "urdf": (".urdf", urdf),
    "mjcf": (".xml", mjcf),
    "sdf": (".sdf", sdf),
}
"""Suffix and writer by format."""
