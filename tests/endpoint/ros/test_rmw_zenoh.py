"""Messages and type hashes, against published values, another implementation's bytes, and the rules written again.

Keys, tokens and attachments are as the design document of rmw_zenoh writes them.
"""

import hashlib
import json
import re
import struct
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores

from guidefield.endpoint.link import Distribution
from guidefield.endpoint.ros import rmw_zenoh
from guidefield.endpoint.ros.rmw_zenoh import (
    LATCHED_QOS,
    MESSAGES,
    MOST_NAMED,
    SERVICES,
    Attachment,
    Entity,
    Kind,
    MismatchReport,
    Node,
    RemoteEntity,
    Types,
    Unreadable,
    types_of,
)
from tests.endpoint.ros.peer import TYPES, new

PUBLISHED = {
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "geometry_msgs/msg/PoseStamped": "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
}
"""Hashes as they stand in keys of ROS 2 systems that others have shown."""
ADD_TWO_INTS = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
"""Of example_interfaces/srv/AddTwoInts, as published: the one service whose hash was found."""
KINDS = {
    "int8": (2, "b"), "uint8": (3, "B"), "int16": (4, "h"), "uint16": (5, "H"), "int32": (6, "i"), "uint32": (7, "I"),
    "int64": (8, "q"), "uint64": (9, "Q"), "float32": (10, "f"), "float64": (11, "d"), "bool": (15, "?"),
    "byte": (16, "B"), "string": (17, ""),
}  # fmt: skip
"""Of each primitive type the number in a type description, and how a number of it is packed."""


def table() -> dict[str, list[tuple[str, str]]]:
    """Fields of every type, with the types of services made by the rules of type descriptions."""
    found = {name: [(_written(kind), field) for field, kind in TYPES.fields(name)] for name in TYPES.names}
    del found["std_msgs/msg/Char"]  # nobody else has a `char`
    found |= {name.replace("/", "/msg/"): _fields(name, fields) for name, fields in MESSAGES.items()}
    for name, (asked, answered) in SERVICES.items():
        own = name.replace("/", "/srv/")
        found[f"{own}_Request"], found[f"{own}_Response"] = _fields(name, asked), _fields(name, answered)
        found[f"{own}_Event"] = [
            ("service_msgs/msg/ServiceEventInfo", "info"),
            (f"{own}_Request[<=1]", "request"),
            (f"{own}_Response[<=1]", "response"),
        ]
        found[own] = [
            (f"{own}_Request", "request_message"),
            (f"{own}_Response", "response_message"),
            (f"{own}_Event", "event_message"),
        ]
    return found


def _written(kind: Any) -> str:
    """A type as definitions write it, of rosbags' description."""
    node, inner = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, count = inner
        return f"{_written(element)}[{'<=' if count and node == Nodetype.SEQUENCE else ''}{count or ''}]"
    return inner[0] if node == Nodetype.BASE else inner


def _fields(name: str, fields: str) -> list[tuple[str, str]]:
    package, found = name.split("/", maxsplit=1)[0], []
    for one in fields.split("\n"):
        kind, field = one.split()
        base, rest = re.fullmatch(r"([\w/]+)(.*)", kind).groups()
        if base not in KINDS:
            base = base.replace("/", "/msg/") if "/" in base else f"{package}/msg/{base}"
        found.append((base + rest, field))
    return found


TABLE = table()


def split(kind: str) -> tuple[str, str, int]:
    """Base, whether "one", "array", "bounded" or "sequence", and how many at most."""
    base, brackets, bound, count = re.fullmatch(r"([\w/]+)(\[(<=)?(\d*)\])?", kind).groups()
    if not brackets:
        return base, "one", 0
    return base, "bounded" if bound else "array" if count else "sequence", int(count or 0)


def described(name: str) -> dict[str, Any]:
    fields = []
    for kind, field in TABLE[name]:
        base, many, count = split(kind)
        number = KINDS[base][0] if base in KINDS else 1
        fields.append(
            {
                "name": field,
                "type": {
                    "type_id": number + {"one": 0, "array": 48, "bounded": 96, "sequence": 144}[many],
                    "capacity": count,
                    "string_capacity": 0,
                    "nested_type_name": "" if base in KINDS else base,
                },
            }
        )
    return {"type_name": name, "fields": fields}


def by_the_rules(name: str) -> str:
    """RIHS01: the SHA-256 of the type's description, and of all that it refers to, as JSON."""
    seen: dict[str, dict[str, Any]] = {}
    waiting = [name]
    while waiting:
        one = waiting.pop()
        if one not in seen:
            seen[one] = described(one)
            waiting += [f["type"]["nested_type_name"] for f in seen[one]["fields"] if f["type"]["nested_type_name"]]
    others = [seen[one] for one in sorted(seen) if one != name]
    text = json.dumps({"type_description": seen[name], "referenced_type_descriptions": others})
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


class Written:
    """CDR by its rules: little-endian, each number aligned to its size from behind the header."""

    def __init__(self) -> None:
        self.data = bytearray()

    def align(self, size: int) -> None:
        self.data += bytes(-len(self.data) % size)

    def one(self, base: str, value: Any) -> None:
        if base == "string":
            text = value.encode() + b"\0"
            self.one("uint32", len(text))
            self.data += text
        elif base in KINDS:
            packed = struct.pack("<" + KINDS[base][1], value)
            self.align(len(packed))
            self.data += packed
        else:
            for kind, field in TABLE[base]:
                self.field(kind, getattr(value, field))

    def field(self, kind: str, value: Any) -> None:
        base, many, _ = split(kind)
        if many == "one":
            self.one(base, value)
            return
        values = value.tolist() if isinstance(value, np.ndarray) else value
        if many != "array":
            self.one("uint32", len(values))
        for one in values:
            self.one(base, one)


def by_hand(message: Any, name: str) -> bytes:
    written = Written()
    written.one(name, message)
    return b"\x00\x01\x00\x00" + bytes(written.data)


def drawn(draw: Any, name: str, depth: int = 0) -> Any:
    """A message of a type, with as much in it as is drawn."""
    values = {}
    for kind, field in TABLE[name]:
        base, many, count = split(kind)
        length = {"one": 1, "array": count}.get(many)
        if length is None:
            length = draw(st.integers(0, min(count or 2, 2) if depth < 3 else 0))
        entries = [_entry(draw, base, depth) for _ in range(length)]
        values[field] = entries[0] if many == "one" else entries
    return new(name, **values)


def _entry(draw: Any, base: str, depth: int) -> Any:
    if base == "string":
        return draw(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5))
    if base == "bool":
        return draw(st.booleans())
    if base.startswith("float"):
        return draw(st.floats(width=32))
    if base in KINDS:
        size = 8 * struct.calcsize(KINDS[base][1])
        signed = base.startswith("int")
        return draw(st.integers(-(2 ** (size - 1)) if signed else 0, 2 ** (size - 1) - 1))
    return drawn(draw, base, depth + 1)


class TestHashes:
    @pytest.mark.parametrize("name", PUBLISHED)
    @pytest.mark.parametrize("distribution", Distribution)
    def test_published_ones(self, distribution: Distribution, name: str):
        assert types_of(distribution).type_hash(name) == PUBLISHED[name]

    def test_a_published_one_of_a_service(self):
        types = Types(Stores.ROS2_JAZZY, MESSAGES, {"example_interfaces/AddTwoInts": ("int64 a\nint64 b", "int64 sum")})
        assert types.type_hash("example_interfaces/srv/AddTwoInts") == ADD_TWO_INTS

    @pytest.mark.parametrize("name", [name.replace("/", "/srv/") for name in SERVICES])
    def test_of_services_as_the_rules_say(self, name: str):
        assert TYPES.type_hash(name) == by_the_rules(name)

    def test_of_messages_as_the_rules_say(self):
        for name in MESSAGES:
            full = name.replace("/", "/msg/")
            assert TYPES.type_hash(full) == by_the_rules(full)


class TestBytes:
    @pytest.mark.parametrize(("message", "name", "theirs"), [
        (
            new(
                "sensor_msgs/msg/JointState",
                header=new("std_msgs/msg/Header", frame_id="base",
                           stamp=new("builtin_interfaces/msg/Time", sec=3, nanosec=4)),
                name=["a", "bc"], position=[1.5, -2.0], effort=[0.25],
            ),
            "sensor_msgs/msg/JointState",
            "00010000030000000400000005000000626173650000000002000000020000006100000003000000626300000200000000000000"
            "000000000000f83f00000000000000c00000000001000000000000000000d03f",
        ),
        (
            new("moveit_msgs/msg/JointConstraint", joint_name="elbow", position=1.0, tolerance_above=0.5,
                tolerance_below=0.25, weight=1.0),
            "moveit_msgs/msg/JointConstraint",
            "0001000006000000656c626f7700000000000000000000000000f03f000000000000e03f000000000000d03f000000000000f03f",
        ),
        (
            new("shape_msgs/msg/SolidPrimitive", type=2, dimensions=[0.5],
                polygon=new("geometry_msgs/msg/Polygon",
                            points=[new("geometry_msgs/msg/Point32", x=1.0, y=2.0, z=3.0)])),
            "shape_msgs/msg/SolidPrimitive",
            "000100000200000001000000000000000000e03f010000000000803f0000004000004040",
        ),
        (
            new("shape_msgs/msg/Mesh", triangles=[new("shape_msgs/msg/MeshTriangle", vertex_indices=[0, 1, 2])],
                vertices=[new("geometry_msgs/msg/Point"), new("geometry_msgs/msg/Point", x=1.0),
                          new("geometry_msgs/msg/Point", y=1.0)]),
            "shape_msgs/msg/Mesh",
            "0001000001000000000000000100000002000000030000000000000000000000000000000000000000000000000000000000"
            "0000000000000000f03f000000000000000000000000000000000000000000000000000000000000f03f0000000000000000",
        ),
        (
            new("trajectory_msgs/msg/JointTrajectory", joint_names=["j"], points=[
                new("trajectory_msgs/msg/JointTrajectoryPoint", positions=[0.5]),
                new("trajectory_msgs/msg/JointTrajectoryPoint", positions=[0.75], velocities=[1.0],
                    time_from_start=new("builtin_interfaces/msg/Duration", sec=1, nanosec=500)),
            ]),
            "trajectory_msgs/msg/JointTrajectory",
            "000100000000000000000000010000000000000001000000020000006a000000020000000100000000000000000000000000e03f0000"
            "00000000000000000000000000000000000001000000000000000000e83f0100000000000000000000000000f03f0000000000000000"
            "01000000f4010000",
        ),
        (
            new("moveit_msgs/msg/MoveItErrorCodes", val=-16, message="no", source="us"),
            "moveit_msgs/msg/MoveItErrorCodes",
            "00010000f0ffffff030000006e6f000003000000757300",
        ),
    ])  # fmt: skip
    def test_as_pycdr2_writes_them(self, message: Any, name: str, theirs: str):
        """Bytes that pycdr2 1.0.0, of Eclipse Cyclone DDS, wrote for the same fields."""
        assert TYPES.write(message, name).hex() == theirs
        assert TYPES.write(TYPES.read(bytes.fromhex(theirs), name), name).hex() == theirs

    @settings(max_examples=18)
    @given(st.data())
    def test_any_message_as_the_rules_say_and_back(self, data: Any):
        travels = [one for one in TABLE if "/msg/" in one or one.endswith(("_Request", "_Response"))]
        name = data.draw(st.sampled_from(travels))
        message = drawn(data.draw, name)
        written = TYPES.write(message, name)
        assert written == by_hand(message, name)
        assert TYPES.write(TYPES.read(written, name), name) == written

    def test_what_is_no_message_says_so(self):
        name = "moveit_msgs/srv/GetMotionPlan_Request"
        whole = TYPES.write(new(name), name)
        for cut in range(len(whole) - 4):
            with pytest.raises(Unreadable, match="is no moveit_msgs"):
                TYPES.read(whole[:cut], name)
        with pytest.raises(Unreadable):
            TYPES.read(whole + bytes(8), name)
        with pytest.raises(Unreadable, match="at most"):
            TYPES.read(bytes(rmw_zenoh.MOST_BYTES + 1), name)

    def test_a_length_beyond_the_payload_costs_nothing(self):
        header = b"\x00\x01\x00\x00" + struct.pack("<iI", 0, 0) + struct.pack("<I", 1) + bytes(4)
        for absurd in (2**31, 2**32 - 1, 10**6):
            with pytest.raises(Unreadable):
                TYPES.read(header + struct.pack("<I", absurd) + bytes(64), "sensor_msgs/msg/JointState")

    def test_an_unknown_field_is_refused(self):
        with pytest.raises(TypeError, match="no field nobody"):
            new("std_msgs/msg/String", nobody=1)

    def test_a_quaternion_that_nobody_gives_is_the_identity(self):
        assert new("geometry_msgs/msg/Pose").orientation.w == 1.0


HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def test_keys():
    chatter = Entity(Kind.PUBLISHER, "chatter", "std_msgs/msg/String", HASH)
    assert chatter.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{HASH}"
    inner = Entity(Kind.SERVICE, "a/b", "example_interfaces/srv/AddTwoInts", HASH)
    assert inner.key(7) == f"7/a/b/example_interfaces::srv::dds_::AddTwoInts_/{HASH}"


def test_tokens():
    node = Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "listener")
    begin = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0"
    assert node.token() == f"{begin}/0/NN/%/%/listener"
    chatter = Entity(Kind.SUBSCRIPTION, "a/chatter", "std_msgs/msg/String", HASH)
    kind = "std_msgs::msg::dds_::String_"
    assert node.token_of(10, chatter) == f"{begin}/10/MS/%/%/listener/%a%chatter/{kind}/{HASH}/::,10:,:,:,,"
    latched = Entity(Kind.PUBLISHER, "x", "std_msgs/msg/String", HASH, LATCHED_QOS)
    assert node.token_of(1, latched).endswith("/:1:,1:,:,:,,")


def test_attachments():
    sender = bytes(range(16))
    written = Attachment(7, sender).write()
    number, at = struct.unpack("<qq", written[:16])
    assert (number, written[16:]) == (7, b"\x10" + sender)
    assert 0 <= time.time_ns() - at < 60e9
    assert Attachment.read(written) == Attachment(7, sender)
    for broken in (b"", written[:-1], written + b"\0", written[:16] + b"\x0f" + written[17:]):
        assert Attachment.read(broken) is None


def test_a_token_is_read_as_it_is_written():
    node = Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "listener")
    chatter = Entity(Kind.CLIENT, "a/chatter", "std_msgs/msg/String", HASH)
    token = node.token_of(10, chatter)
    assert RemoteEntity.read(token) == RemoteEntity("listener", "SC", "a/chatter", "std_msgs::msg::dds_::String_", HASH)
    inside = token.replace("/%/listener/", "/%robots%arm/listener/")
    assert RemoteEntity.read(inside) == RemoteEntity(
        "robots/arm/listener", "SC", "a/chatter", "std_msgs::msg::dds_::String_", HASH
    )
    for other in (node.token(), f"{token}/x", token.replace("@ros2_lv", "@other"), ""):
        assert RemoteEntity.read(other) is None


def test_who_has_another_version_of_a_type_is_named_once():
    ours = Entity(Kind.SERVICE, "adds", "example_interfaces/srv/AddTwoInts", HASH)
    heard = Entity(Kind.SUBSCRIPTION, "chatter", "std_msgs/msg/String", HASH)
    told: list[str] = []
    strangers = MismatchReport([ours, heard], told.append)

    def look(kind: Kind, name: str, type_name: str, type_hash: str, node: str = "asks") -> None:
        strangers.check(Node(0, "1a", node).token_of(3, Entity(kind, name, type_name, type_hash)))

    for kind, name in ((Kind.CLIENT, "adds"), (Kind.SERVICE, "adds"), (Kind.CLIENT, "other")):
        look(kind, name, ours.type_name, HASH)
    look(Kind.CLIENT, "chatter", heard.type_name, "RIHS01_other")
    assert told == []
    for _ in range(2):
        look(Kind.CLIENT, "adds", ours.type_name, "RIHS01_other")
        look(Kind.PUBLISHER, "chatter", "std_msgs/msg/Text", HASH)
    assert len(told) == 2
    assert "node 'asks' has adds as example_interfaces::srv::dds_::AddTwoInts_ of RIHS01_other" in told[0]
    assert "`--ros-distro`" in told[0]
    for number in range(2 * MOST_NAMED):
        look(Kind.CLIENT, "adds", ours.type_name, "RIHS01_other", f"node{number}")
    assert len(told) == MOST_NAMED
