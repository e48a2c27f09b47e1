"""Keys, tokens and attachments, as the design document of rmw_zenoh writes them."""

import struct
import time

from guidefield.endpoint.ros.names import (
    LATCHED_QOS,
    MOST_NAMED,
    Attachment,
    Entity,
    Kind,
    MismatchReport,
    Node,
    RemoteEntity,
)

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
