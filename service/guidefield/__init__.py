"""Motion planning and kinematics for any URDF robot in the field of charged polygons: certified, over Zenoh, recorded.

The door is lazy: importing it, or the client through it, loads no planner.
"""

from __future__ import annotations

import importlib
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
        Preempted as Preempted,
        RequestTooLarge as RequestTooLarge,
        RobotInvalid as RobotInvalid,
        SceneInvalid as SceneInvalid,
        ServerBusy as ServerBusy,
        Status as Status,
        TimedOut as TimedOut,
        UnknownFrame as UnknownFrame,
        UnknownObject as UnknownObject,
        WorkerCrashed as WorkerCrashed,
    )
    from guidefield.messages.replies import (
        CertifyReply as CertifyReply,
        PlanReply as PlanReply,
        Progress as Progress,
    )
    from guidefield.messages.requests import (
        CertifyRequest as CertifyRequest,
        Clearance as Clearance,
        ForwardKinematics as ForwardKinematics,
        GuidePlaneGoal as GuidePlaneGoal,
        InverseKinematics as InverseKinematics,
        JointSetGoal as JointSetGoal,
        JointsGoal as JointsGoal,
        PlanRequest as PlanRequest,
        PoseGoal as PoseGoal,
        Potential as Potential,
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
    from guidefield.messages.values import Placement as Placement

    __version__: str

_ROOMS = {
    "client": ("AsyncClient", "Client"),
    "endpoint.service": ("ServiceSettings", "serve"),
    "engine": ("Engine", "answer"),
    "errors": (
        "GuidefieldError",
        "DiskRefused",
        "InternalFailure",
        "InvalidConfiguration",
        "InvalidGoal",
        "InvalidGroup",
        "MalformedRequest",
        "NoService",
        "Preempted",
        "RequestTooLarge",
        "RobotInvalid",
        "SceneInvalid",
        "ServerBusy",
        "Status",
        "TimedOut",
        "UnknownFrame",
        "UnknownObject",
        "WorkerCrashed",
    ),
    "messages.replies": ("CertifyReply", "PlanReply", "Progress"),
    "messages.requests": (
        "CertifyRequest",
        "Clearance",
        "ForwardKinematics",
        "GuidePlaneGoal",
        "InverseKinematics",
        "JointSetGoal",
        "JointsGoal",
        "PlanRequest",
        "PoseGoal",
        "Potential",
        "TargetPose",
        "UrdfFile",
        "UrdfText",
    ),
    "messages.scene": (
        "Box",
        "Capsule",
        "Cylinder",
        "GuidePlane",
        "HalfSpace",
        "Mesh",
        "PointCloud",
        "Polygon",
        "Scene",
        "Sphere",
    ),
    "messages.values": ("Placement",),
    "arrays": ("RunArrays", "run_arrays"),
}
"""Public names by the room that holds them."""

_HOMES = {name: f"guidefield.{room}" for room, names in _ROOMS.items() for name in names}

__all__ = ["__version__", *_HOMES]  # noqa: PLE0604 - computed from the one table


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("guidefield")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
