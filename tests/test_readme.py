"""The README's Python, run as it stands: against a service on the port it names, and a robot of one's own."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.journeys.service import running_service

README = (Path(__file__).parents[1] / "README.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
ARM = """<robot name="mine">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.05 0.05 0.6"/></geometry></collision></link>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: "network" if "Client" in block else "here")
def test_the_readme_does_what_it_says(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my_robot.urdf").write_text(ARM)
    monkeypatch.chdir(tmp_path)
    if "Client" in block:
        with running_service(tmp_path / "data", "--workers", "1", "--prepare", "ur5") as service:
            assert "tcp/127.0.0.1:7447" in block
            exec(block.replace("tcp/127.0.0.1:7447", service.endpoint), {})
    else:
        exec(block, {})
    assert capsys.readouterr().out.startswith("SUCCESS ")
    assert len(block.splitlines()) <= 11
