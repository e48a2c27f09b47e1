from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest

from guidefield.endpoint.service import CannotServe, ServiceSettings, serve, session_config
from guidefield.errors import MalformedRequest


def test_it_listens_on_loopback_and_scouts_nobody_unless_told(tmp_path: Path) -> None:
    config = session_config(ServiceSettings(tmp_path))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    assert config.get_json("scouting/multicast/enabled") == config.get_json("scouting/gossip/enabled") == "false"


def test_a_configuration_file_has_its_way(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{ listen: { endpoints: ["tcp/10.0.0.1:1"] }, scouting: { multicast: { enabled: true } } }')
    config = session_config(ServiceSettings(tmp_path, config=file))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/10.0.0.1:1"]
    assert config.get_json("scouting/multicast/enabled") == "true"
    assert config.get_json("scouting/gossip/enabled") == "false"
    named = session_config(ServiceSettings(tmp_path, config=file, listen=("tcp/127.0.0.1:2",)))
    assert json.loads(named.get_json("listen/endpoints")) == ["tcp/127.0.0.1:2"]


def test_a_file_that_says_nothing_about_it_leaves_loopback(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{ connect: { endpoints: ["tcp/127.0.0.1:1"] } }')
    config = session_config(ServiceSettings(tmp_path, config=file))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    assert config.get_json("scouting/multicast/enabled") == "false"


def test_a_mistake_in_a_configuration_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ lisen: {} }")
    with pytest.raises(CannotServe, match="lisen"):
        session_config(ServiceSettings(tmp_path, config=file))


def test_a_name_that_is_no_chunk_of_a_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MalformedRequest, match="instance"):
        serve(ServiceSettings(tmp_path, instance="a/b"), threading.Event())


def test_a_data_folder_has_one_service(tmp_path: Path) -> None:
    import fcntl

    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(CannotServe, match="alive on the data folder"):
            serve(ServiceSettings(tmp_path), threading.Event())
