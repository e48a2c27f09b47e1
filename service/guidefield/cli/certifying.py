"""The request that `guidefield certify` makes, from a file or a kept run and from options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from guidefield.cli.found_run import find_run
from guidefield.cli.motion_files import ENDINGS, fields_of, recorded_fields
from guidefield.errors import MalformedRequest
from guidefield.messages import codec, requests
from guidefield.messages.scene import Scene

ROBOT_ENDINGS = (".urdf", ".xacro", ".xml")
"""Ends of the names of robot files, in any letters' case."""


def robot_reference(
    robot: str, srdf: Path | None, package_dirs: Sequence[Path], xacro_args: Sequence[str]
) -> requests.RobotReference:
    """Return the robot that an argument means: a name, or a file with its SRDF, package folders and xacro arguments.

    Raises:
        MalformedRequest: if an argument of xacro isn't ``name:=value``, or the robot isn't a file.
    """
    if not robot.lower().endswith(ROBOT_ENDINGS):
        if xacro_args:
            raise MalformedRequest(f"--xacro-arg goes with a .xacro file, not with the robot {robot!r}")
        return robot
    arguments: dict[str, str | bool | int | float] = {}
    for argument in xacro_args:
        name, separator, value = argument.partition(":=")
        if not (name and separator):
            raise MalformedRequest(f"--xacro-arg must be name:=value, got {argument!r}")
        arguments[name] = value
    folders = [str(folder) for folder in package_dirs]
    srdf_path = None if srdf is None else str(srdf)
    return requests.UrdfFile(robot, srdf_path=srdf_path, package_dirs=folders, xacro_args=arguments)


def scene_reference(scene: str) -> requests.SceneReference:
    """The scene that an argument means: a name, or a `.json` file.

    Raises:
        MalformedRequest: if the file can't be read, or holds no scene.
    """
    if not scene.endswith(".json"):
        return scene
    try:
        content = Path(scene).read_bytes()
    except OSError as error:
        raise MalformedRequest(f"the scene can't be read: {scene}: {error.strerror}", path=scene) from None
    decoded: Scene = codec.decode(content, Scene)
    return decoded


def certify_request(
    motion: str, given: Mapping[str, Any], allowed_time: float, data: Path | None, name: str
) -> requests.CertifyRequest:
    """The request about a motion.

    Args:
        motion: A file, or the id of a kept run.
        given: Fields that replace those of the file or run, where they aren't None.
        allowed_time: How long it may take [s].
        data: The data folder of the service that kept the run; None: the user's.
        name: The name of that service.

    Raises:
        UnknownObject, MalformedRequest: if there is no such file or run, or it holds no motion; if no robot or scene is
            known.
    """
    if motion.endswith(ENDINGS):
        fields = fields_of(Path(motion))
    else:
        found = find_run(motion, data, name)
        fields = recorded_fields(found.request, msgspec.to_builtins(found.reply), motion)
    fields |= {field: msgspec.to_builtins(value) for field, value in given.items() if value is not None}
    if given["time_step"] is not None and "path" in fields:
        fields["trajectory"] = {"positions": fields.pop("path")}
    for field in ("robot", "scene"):
        if field not in fields:
            raise MalformedRequest(f"{motion!r} says no {field}: give --{field}", field=field)
    request = codec.decode_request({"type": "certify", **fields, "allowed_time": allowed_time})
    assert isinstance(request, requests.CertifyRequest), "a certify request was made"
    return request
