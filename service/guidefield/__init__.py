"""Motion planning and kinematics for any URDF robot in the field of charged polygons: certified, over Zenoh, recorded.

Names are loaded when they are first used: importing the package, or the client from it, loads no planner. The
distribution `guidefield-client` has this file too. A new public name goes into `_ROOMS` and the imports for types.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guidefield.arrays import RunArrays as RunArrays, run_arrays as run_arrays
    from guidefield.client import AsyncClient as AsyncClient, Client as Client
    from guidefield.endpoint.service import ServiceSettings as ServiceSettings, serve as serve
    from guidefield.engine import Engine as Engine, answer as answer
    from guidefield.errors import (
        DiskRefused as DiskRefused,
        GuidefieldError as GuidefieldError,
        InternalFailure as InternalFailure,
        InvalidConfiguration as InvalidConfiguration,
        InvalidGoal as InvalidGoal,
        InvalidGroup as InvalidGroup,
        MalformedRequest as MalformedRequest,
        NoService as NoService,
        NotAllowed as NotAllowed,
        Preempted as Preempted,
        QuotaExceeded as QuotaExceeded,
        RequestTooLarge as RequestTooLarge,
        RobotInvalid as RobotInvalid,
        SceneInvalid as SceneInvalid,
        ServerBusy as ServerBusy,
        Status as Status,
        StreamUnknown as StreamUnknown,
        TimedOut as TimedOut,
        UnknownFrame as UnknownFrame,
        UnknownObject as UnknownObject,
        WorkerCrashed as WorkerCrashed,
    )
    from guidefield.messages.certify_reply import JointStates as JointStates, judgement_of as judgement_of
    from guidefield.messages.replies import (
        CertifyReply as CertifyReply,
        PlanReply as PlanReply,
        Progress as Progress,
    )
    from guidefield.messages.requests import (
        Attach as Attach,
        CertifyRequest as CertifyRequest,
        Clearance as Clearance,
        ConfigurationTable as ConfigurationTable,
        Dynamics as Dynamics,
        ExecutionOptions as ExecutionOptions,
        ForwardKinematics as ForwardKinematics,
        GuidePlaneGoal as GuidePlaneGoal,
        InverseKinematics as InverseKinematics,
        Jacobian as Jacobian,
        JointSetGoal as JointSetGoal,
        JointsGoal as JointsGoal,
        Payload as Payload,
        PlanRequest as PlanRequest,
        PlanStep as PlanStep,
        PoseGoal as PoseGoal,
        Potential as Potential,
        RelativeGoal as RelativeGoal,
        TargetPose as TargetPose,
        UrdfFile as UrdfFile,
        UrdfText as UrdfText,
    )
    from guidefield.messages.scene import (
        Box as Box,
        Capsule as Capsule,
        Cylinder as Cylinder,
        GuidePlane as GuidePlane,
        HalfSpace as HalfSpace,
        Mesh as Mesh,
        PointCloud as PointCloud,
        Polygon as Polygon,
        Scene as Scene,
        Sphere as Sphere,
    )
    from guidefield.messages.scene_changes import RequestScene as RequestScene
    from guidefield.messages.streams import (
        Deviation as Deviation,
        Observation as Observation,
        Piece as Piece,
        StreamObstacle as StreamObstacle,
        StreamOpen as StreamOpen,
        StreamState as StreamState,
        StreamUpdate as StreamUpdate,
    )
    from guidefield.messages.values import Placement as Placement
    from guidefield.stream.in_process import Stream as Stream

    __version__: str

_ROOMS = {
    "client": ("AsyncClient", "Client"),
    "endpoint.service": ("ServiceSettings", "serve"),
    "engine": ("Engine", "answer"),
    "errors": (
        "GuidefieldError", "DiskRefused", "InternalFailure", "InvalidConfiguration", "InvalidGoal",
        "InvalidGroup", "MalformedRequest", "NoService", "NotAllowed", "Preempted", "QuotaExceeded",
        "RequestTooLarge", "RobotInvalid", "SceneInvalid", "ServerBusy", "Status", "StreamUnknown", "TimedOut",
        "UnknownFrame", "UnknownObject", "WorkerCrashed",
    ),
    "messages.certify_reply": ("JointStates", "judgement_of"),
    "messages.replies": ("CertifyReply", "PlanReply", "Progress"),
    "messages.requests": (
        "Attach", "CertifyRequest", "Clearance", "ConfigurationTable", "Dynamics", "ExecutionOptions",
        "ForwardKinematics", "GuidePlaneGoal", "InverseKinematics", "Jacobian", "JointSetGoal", "JointsGoal",
        "PlanRequest", "PlanStep", "PoseGoal", "Payload", "Potential", "RelativeGoal", "TargetPose", "UrdfFile",
        "UrdfText",
    ),
    "messages.scene": (
        "Box", "Capsule", "Cylinder", "GuidePlane", "HalfSpace", "Mesh", "PointCloud", "Polygon", "Scene",
        "Sphere",
    ),
    "messages.scene_changes": ("RequestScene",),
    "messages.streams": (
        "Deviation", "Observation", "Piece", "StreamObstacle", "StreamOpen", "StreamState", "StreamUpdate",
    ),
    "messages.values": ("Placement",),
    "stream.in_process": ("Stream",),
    "arrays": ("RunArrays", "run_arrays"),
}  # fmt: skip
"""Public names by the room that holds them."""

_SERVICE_ROOMS = ("endpoint.service", "engine", "arrays", "stream.in_process")
"""Rooms that `guidefield-client` doesn't have."""
_HERE = Path(__file__).parent
_IS_WHOLE = (_HERE / "engine.py").exists()
_LIGHT = _HERE / "light_client.txt"
"""The version file, which only `guidefield-client` has."""

_HOMES = {name: f"guidefield.{room}" for room, names in _ROOMS.items() for name in names}

_AVAILABLE = [name for room, names in _ROOMS.items() if _IS_WHOLE or room not in _SERVICE_ROOMS for name in names]
__all__ = ["__version__", *_AVAILABLE]  # noqa: PLE0604 - computed from the one table

if _IS_WHOLE and _LIGHT.exists():
    import warnings

    warnings.warn(
        "guidefield and guidefield-client are both installed and share their files, which may be of two versions: "
        "`pip uninstall guidefield-client`, then `pip install --force-reinstall --no-deps guidefield`",
        stacklevel=2,
    )


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("guidefield") if _IS_WHOLE else _LIGHT.read_text().strip()
    elif name in _HOMES and name not in __all__:
        raise ImportError(f"guidefield.{name} isn't in guidefield-client, which only asks: pip install guidefield")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        if _IS_WHOLE and "IPython" in sys.modules:
            importlib.import_module("guidefield.notebook").register_displays()
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
