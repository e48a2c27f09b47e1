"""Frames by name where a joint and a link share one."""

from __future__ import annotations

from guidefield.messages.requests import UrdfText
from guidefield.robot.model.model import frame_index
from tests.robots import load

SHARED = (
    '<robot name="r"><link name="a"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    '<link name="b"/>'
    '<joint name="b" type="revolute"><origin xyz="0 0 1"/><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
)


def test_the_link_is_meant() -> None:
    model = load(UrdfText(text=SHARED)).model
    index = frame_index(model, "b")
    assert index is not None
    assert model.frames[index].type.name == "BODY"
    assert load(UrdfText(text=SHARED)).frame_id("b") == index
