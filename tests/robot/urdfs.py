"""URDFs for the intake: a sound one, and every fault that it can have."""

import pinocchio as pin

from guidefield.robot.model.neutral_names import capture_stderr

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><sphere radius="0.1"/></geometry></visual>
    <collision><origin xyz="0 0 0.2"/><geometry><box size="0.1 0.1 0.4"/></geometry></collision>
  </link>
  <link name="hand"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <origin xyz="0 0 0.1" rpy="0 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="10" velocity="2"/>
  </joint>
  <joint name="wrist" type="continuous">
    <parent link="upper"/>
    <child link="hand"/>
    <axis xyz="0 1 0"/>
    <mimic joint="shoulder" multiplier="2" offset="0.5"/>
  </joint>
</robot>
"""

LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="2"/>'
BOX = '<box size="0.1 0.1 0.4"/>'
AXIS = '<axis xyz="0 0 1"/>'
MIMIC = '<mimic joint="shoulder" multiplier="2" offset="0.5"/>'
ORIGIN = 'xyz="0 0 0.1" rpy="0 0 0"'

RING = (
    '<link name="p"/><link name="q"/>'
    '<joint name="pq" type="continuous"><parent link="p"/><child link="q"/></joint>'
    '<joint name="qp" type="continuous"><parent link="q"/><child link="p"/></joint>'
)

FAULTS = {
    "not XML": (("</robot>", "<robot>"), 23, None, "not XML"),
    "root element": ((ARM, "<model name='a'/>"), 1, "model", "must be <robot>"),
    "version": (('<robot name="arm"', '<robot name="arm" version="2.0"'), 1, "robot", "1.0, 1.1 or 1.2"),
    "no links": ((ARM, "<robot name='r'/>"), 1, "robot", "at least one <link>"),
    "nameless link": (('<link name="hand"/>', "<link/>"), 8, "link", "must have a name"),
    "duplicate link": (
        ('<link name="hand"/>', '<link name="base"/>'),
        8,
        "link",
        "already that of the <link> in line 2",
    ),
    "duplicate joint": (('name="wrist"', 'name="shoulder"'), 16, "joint", "already that of the <joint> in line 9"),
    "ball joint": (('"continuous"', '"spherical"'), 16, "joint", "has no ball joints"),
    "unknown type": (
        ('"continuous"', '"hinge"'),
        16,
        "joint",
        "revolute, continuous, prismatic, fixed, floating, planar",
    ),
    "no type": ((' type="continuous"', ""), 16, "joint", "<joint> must have 'type'"),
    "no parent": (('<parent link="base"/>', ""), 9, "joint", "one <parent"),
    "no child": (('<child link="hand"/>', "<child/>"), 16, "joint", "one <child"),
    "unknown parent": (('<parent link="base"/>', '<parent link="bass"/>'), 10, "parent", "'bass' does not exist"),
    "unknown child": (('<child link="hand"/>', '<child link="hans"/>'), 18, "child", "base, upper, hand"),
    "two roots": (
        ('<link name="hand"/>', '<link name="hand"/><link name="lost"/>'),
        1,
        "robot",
        "base, lost have no parent",
    ),
    "two parents": (('<child link="hand"/>', '<child link="upper"/>'), 16, "joint", "child of joint 'shoulder'"),
    "loop": (('<parent link="base"/>', '<parent link="hand"/>'), 9, "joint", "loop through"),
    "loop beside a tree": (("</robot>", f"{RING}</robot>"), 22, "joint", "loop through q, p"),
    "its own parent": (('<parent link="base"/>', '<parent link="upper"/>'), 9, "joint", "loop through upper"),
    "no limit": ((LIMIT, ""), 9, "joint", "must have <limit>"),
    "NaN limit": (('lower="-1"', 'lower="nan"'), 14, "limit", "finite number, got 'nan'"),
    "infinite limit": (('upper="1"', 'upper="inf"'), 14, "limit", "finite number, got 'inf'"),
    "overflowing limit": (('upper="1"', 'upper="1e999"'), 14, "limit", "finite number, got '1e999'"),
    "limit in words": (('upper="1"', 'upper="one"'), 14, "limit", "finite number, got 'one'"),
    "unexpanded limit": (('upper="1"', 'upper="${pi}"'), 14, "limit", "expand the file with xacro"),
    "empty limit": (('upper="1"', 'upper=""'), 14, "limit", "got 0"),
    "decimal comma": (('velocity="2"', 'velocity="2,5"'), 14, "limit", "got '2,5'"),
    "underscore": (('velocity="2"', 'velocity="2_0"'), 14, "limit", "got '2_0'"),
    "NaN origin": ((ORIGIN, 'xyz="0 nan 0"'), 12, "origin", "3 finite numbers, got 'nan'"),
    "short origin": ((ORIGIN, 'xyz="0 0"'), 12, "origin", "3 finite numbers, got 2"),
    "far origin": ((ORIGIN, 'xyz="0 0 1e300"'), 12, "origin", "at most 1e+06"),
    "infinite rpy": ((ORIGIN, 'rpy="0 inf 0"'), 12, "origin", "'rpy' of <origin>"),
    "quaternion before 1.1": ((ORIGIN, 'quat_xyzw="0 0 0 1"'), 12, "origin", 'version="1.1"'),
    "zero axis": ((AXIS, '<axis xyz="0 0 0"/>'), 13, "axis", "must not be zero"),
    "NaN axis": ((AXIS, '<axis xyz="0 0 nan"/>'), 13, "axis", "3 finite numbers"),
    "short axis": ((AXIS, '<axis xyz="0 1"/>'), 13, "axis", "got 2: '0 1'"),
    "flat box": ((BOX, '<box size="0.1 0.1"/>'), 6, "box", "3 finite numbers, got 2"),
    "negative box": ((BOX, '<box size="0.1 0.1 -0.4"/>'), 6, "box", "must be positive"),
    "box without size": ((BOX, "<box/>"), 6, "box", "must have 'size'"),
    "negative sphere": ((BOX, '<sphere radius="-1"/>'), 6, "sphere", "must be positive"),
    "NaN sphere": ((BOX, '<sphere radius="nan"/>'), 6, "sphere", "finite number"),
    "disc": ((BOX, '<cylinder radius="0.1"/>'), 6, "cylinder", "must have 'length'"),
    "capsule before 1.1": ((BOX, '<capsule radius="0.1" length="0.2"/>'), 6, "capsule", 'version="1.1"'),
    "unknown shape": ((BOX, '<cone radius="0.1"/>'), 6, "cone", "one of box, cylinder, sphere, mesh"),
    "empty geometry": ((BOX, ""), 6, "collision", "<geometry> with a shape"),
    "no geometry": ((f"<geometry>{BOX}</geometry>", ""), 6, "collision", "<geometry> with a shape"),
    "mesh without a name": ((BOX, "<mesh/>"), 6, "mesh", "must have 'filename'"),
    "mesh scale": ((BOX, '<mesh filename="a.stl" scale="2 3"/>'), 6, "mesh", "3 finite numbers, got 2"),
    "mesh over the net": ((BOX, '<mesh filename="http://a.b/c.stl"/>'), 6, "mesh", "cannot be fetched"),
    "mesh of no package": ((BOX, '<mesh filename="package://lost/c.stl"/>'), 6, "mesh", "was not found"),
    "mesh elsewhere": ((BOX, '<mesh filename="/etc/c.stl"/>'), 6, "mesh", "outside what is allowed"),
    "not a mesh": ((BOX, '<mesh filename="package://a/passwd"/>'), 6, "mesh", "not a mesh file"),
    "mimic of nothing": ((MIMIC, '<mimic joint="elbow"/>'), 20, "mimic", "no such joint; there are shoulder, wrist"),
    "mimic of no name": ((MIMIC, "<mimic/>"), 20, "mimic", "no such joint"),
    "mimic of itself": ((MIMIC, '<mimic joint="wrist"/>'), 20, "mimic", "mimic itself"),
    "mimic cycle": ((LIMIT, LIMIT + '<mimic joint="wrist"/>'), 14, "mimic", "shoulder mimics wrist mimics shoulder"),
    "mimic of a fixed joint": (('type="revolute"', 'type="fixed"'), 20, "mimic", "which is fixed"),
    "mimic multiplier": (('multiplier="2"', 'multiplier="nan"'), 20, "mimic", "finite number"),
    "huge multiplier": (('multiplier="2"', 'multiplier="1e300"'), 20, "mimic", "finite number of at most 1e+06"),
    "no speed at all": (('velocity="2"', 'velocity="1e-320"'), 14, "limit", "must be 0 or at least 1e-09"),
    "mimic offset": (('offset="0.5"', 'offset="half"'), 20, "mimic", "finite number"),
    "floating mimic": (('"continuous"', '"floating"'), 20, "mimic", "a floating joint can't mimic"),
    "doctype": (("<robot ", "<!DOCTYPE robot>\n<robot "), 1, "!DOCTYPE", "DOCTYPE"),
    "xacro": (
        ('<link name="base"/>', '<x:if xmlns:x="http://ros.org/wiki/xacro" value="1"/><link name="base"/>'),
        2,
        "{http://ros.org/wiki/xacro}if",
        "expand it first",
    ),
}


def faulty(name: str) -> str:
    old, new = FAULTS[name][0]
    assert old in ARM
    return ARM.replace(old, new, 1)


def pinocchio_models(text: str) -> tuple:
    with capture_stderr():
        model = pin.buildModelFromXML(text)
        geometry = pin.GeometryModel()
        pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, geometry, [])
    return model, geometry
