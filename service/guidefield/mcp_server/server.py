"""The server of the Model Context Protocol, over standard input and output; needs ``guidefield[mcp]``.

`TOOLS` are its tools; names, descriptions and schemas are what models read, and none moves a robot. All are announced
as reading only.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from guidefield.client import AsyncClient
from guidefield.errors import GuidefieldError, MalformedRequest, UnknownObject, convert_exception
from guidefield.mcp_server import words
from guidefield.messages.replies import (
    PlanReply,
    RunReply,
    make_error_reply,
    to_plain_data,
)
from guidefield.messages.requests import CertifyRequest, Clearance, InverseKinematics, PlanRequest
from guidefield.messages.schemas import make_schemas_of


@dataclass(frozen=True)
class Tool:
    """A tool of a model."""

    name: str
    what: str  # its purpose, for the model to read
    schema: dict[str, Any]  # JSON Schema of its arguments
    ask: Callable[[AsyncClient, dict[str, Any]], Awaitable[Any]]  # asks the service
    describe: Callable[[Any], str]  # puts the reply into words
    figures: Callable[[Any], dict[str, Any]] = msgspec.to_builtins  # makes plain data of the reply


def _plan_figures(reply: PlanReply) -> dict[str, Any]:
    figures: dict[str, Any] = msgspec.to_builtins(reply)
    motion = figures.pop("trajectory")
    return {**figures, "knots": 0 if motion is None else len(motion["times"])}


async def _read_plan(client: AsyncClient, given: dict[str, Any]) -> PlanReply:
    run = await client.run(given["run_id"])
    if not isinstance(run, RunReply):
        raise MalformedRequest(f"run {run.run_id!r} judged a motion that was given: it has the trajectory already")
    if run.reply is None or run.reply.trajectory is None:
        raise UnknownObject(f"run {run.run_id!r} has no trajectory", run_id=run.run_id)
    return run.reply


def _describe_trajectory(reply: PlanReply) -> str:
    assert reply.trajectory is not None, "it was asked for"
    return (
        f"{len(reply.trajectory.times)} rows over {reply.trajectory.times[-1]:.2f} s: the cubic Hermite curve through"
        " times, positions and velocities is what was certified, where no `sample_rate` was asked for."
    )


def _trajectory_figures(reply: PlanReply) -> dict[str, Any]:
    names = {"position_names": reply.position_names, "velocity_names": reply.velocity_names}
    return {**names, **msgspec.to_builtins(reply.trajectory)}


def _schema(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Make the JSON Schema of a message without its tag, which the tool implies."""
    (root,), parts = make_schemas_of([kind])
    whole = dict(parts.pop(root["$ref"].rpartition("/")[2]))
    tag = kind.__struct_config__.tag_field
    whole["properties"] = {field: what for field, what in whole["properties"].items() if field != tag}
    whole["required"] = [field for field in whole["required"] if field != tag]
    whole["description"] = f"{whole['description']} (a message of `guidefield docs wire`)"
    return {**whole, "$defs": parts}


def _named(field: str, what: str) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {field: {"type": "string", "description": what}},
        "required": [field],
        "additionalProperties": False,
    }


NOTHING: dict[str, Any] = {"type": "object", "properties": {}, "additionalProperties": False}
"""The schema of a tool that takes no arguments."""

TOOLS = (
    Tool(
        "plan",
        "Plan a motion of a robot to a goal, free of collisions over its whole length and within limits. Nothing moves."
        " Metres, radians, seconds; positions in the world; quaternions x, y, z, w. Robot, scene and goal are enough; a"
        ' goal is such as {"type": "joints", "positions": {"elbow_joint": 1.2}} or {"type": "pose", "position": [x, y,'
        ' z], "quaternion_xyzw": [x, y, z, w]}.',
        _schema(PlanRequest),
        lambda client, given: client.plan(given),
        words.describe_plan,
        _plan_figures,
    ),
    Tool(
        "certify",
        "Judge a motion that is given, a `path` of waypoints or a `trajectory` in time: is it free between its rows"
        " too, and within limits?",
        _schema(CertifyRequest),
        lambda client, given: client.certify({"type": "certify", **given}),
        words.describe_verdict,
    ),
    Tool(
        "clearance",
        "Distances of a robot to a scene's obstacles, and to itself, at configurations.",
        _schema(Clearance),
        lambda client, given: client.kinematics({"type": "clearance", **given}),
        words.describe_clearance,
    ),
    Tool(
        "inverse_kinematics",
        "Configurations that bring a robot's tip to poses; with `collision_free` and a scene those that touch nothing.",
        _schema(InverseKinematics),
        lambda client, given: client.kinematics({"type": "inverse_kinematics", **given}),
        words.describe_solutions,
    ),
    Tool(
        "robots",
        "List the robots that can be named.",
        NOTHING,
        lambda client, _: client.robots(),
        words.list_robots,
    ),
    Tool(
        "robot",
        "Describe a robot: joints, limits, groups, frames, tip.",
        _named("name", "Of the robot."),
        lambda client, given: client.robot(given["name"]),
        words.describe_robot,
    ),
    Tool(
        "scenes",
        "List the scenes that can be named.",
        NOTHING,
        lambda client, _: client.scenes(),
        lambda names: f"Scenes: {', '.join(names)}.",
        lambda names: {"scenes": names},
    ),
    Tool(
        "scene",
        "Read a scene: its obstacles and guide planes.",
        _named("name", "Of the scene."),
        lambda client, given: client.scene(given["name"]),
        words.describe_scene,
    ),
    Tool(
        "trajectory",
        "The whole trajectory of a plan that was made: times, positions, velocities, accelerations.",
        _named("run_id", "What the plan's reply calls its run."),
        _read_plan,
        _describe_trajectory,
        _trajectory_figures,
    ),
)
"""All tools."""


INSTRUCTIONS = (
    "Plans, judges and measures motions of robots; it never moves one. Ask `robots` and `scenes` for names. A plan"
    " whose status is SUCCESS is certified: free of collisions between its samples too, and within limits. Any other"
    " status is an honest no, with its reason and what to do."
)

_log = logging.getLogger(__name__)


class Service:
    """The service that is asked; connected to at the first use, and at the next one if that failed."""

    def __init__(self, endpoints: tuple[str, ...], instance: str | None, config: Path | None, user: str | None) -> None:
        self._where = endpoints, instance, config, user
        self._client: AsyncClient | None = None
        self._connecting = asyncio.Lock()

    async def client(self) -> AsyncClient:
        """Return a connected client.

        Raises:
            NoService: if nobody answers there.
            MalformedRequest: if an endpoint isn't one, or the configuration is wrong.
        """
        endpoints, instance, config, user = self._where
        async with self._connecting:
            if self._client is None:
                try:
                    self._client = await AsyncClient.connect(*endpoints, instance=instance, config=config, user=user)
                except ValueError as error:
                    raise MalformedRequest(str(error)) from None
            return self._client

    async def close(self) -> None:
        """Close the connection, if there is one."""
        if self._client is not None:
            await self._client.close()


def serve_stdio(endpoints: tuple[str, ...], instance: str | None, config: Path | None, user: str | None) -> None:
    """Serve over standard input and output until the input ends; raises ImportError without the package mcp."""
    import mcp.server.stdio  # noqa: F401 - raises at once without it

    asyncio.run(_serve(Service(endpoints, instance, config, user)))


async def _serve(service: Service) -> None:
    from mcp.server.stdio import stdio_server

    server = protocol_server(service)
    async with contextlib.AsyncExitStack() as opened:
        opened.push_async_callback(service.close)
        reading, writing = await opened.enter_async_context(stdio_server())
        await server.run(reading, writing, server.create_initialization_options())


def protocol_server(service: Service) -> Any:
    """Return the protocol's server, which asks a service."""
    import mcp_types as types
    from mcp.server import Server

    hints = types.ToolAnnotations(read_only_hint=True, destructive_hint=False, open_world_hint=False)
    listed = types.ListToolsResult(
        tools=[
            types.Tool(name=tool.name, description=tool.what, input_schema=tool.schema, annotations=hints)
            for tool in TOOLS
        ]
    )
    known = {tool.name: tool for tool in TOOLS}

    async def list_tools(_context: Any, _params: Any) -> Any:
        return listed

    async def call_tool(_context: Any, params: Any) -> Any:
        text, figures, failed = await _call_tool(service, known.get(params.name), params.name, params.arguments or {})
        return types.CallToolResult(content=[types.TextContent(text=text)], structured_content=figures, is_error=failed)

    return Server(
        "guidefield",
        version=version("guidefield"),
        instructions=INSTRUCTIONS,
        on_list_tools=list_tools,
        on_call_tool=call_tool,
    )


async def _call_tool(
    service: Service, tool: Tool | None, name: str, given: dict[str, Any]
) -> tuple[str, dict[str, Any], bool]:
    """Return a tool's answer in words and figures, and whether it is an error; raises nothing but cancellation."""
    try:
        if tool is None:
            raise MalformedRequest(f"there is no tool {name[:64]!r}; there are {', '.join(one.name for one in TOOLS)}")
        _refuse_other_arguments(tool, given)
        reply = await tool.ask(await service.client(), given)
        return tool.describe(reply), tool.figures(reply), False
    except GuidefieldError as error:
        failure = error
    except Exception as error:
        _log.exception("tool %s failed by itself", name)
        failure = convert_exception(error)
    return words.describe_error(failure), to_plain_data(make_error_reply(failure)), True


def _refuse_other_arguments(tool: Tool, given: dict[str, Any]) -> None:
    """Refuse unknown arguments, missing ones and names that are no texts; the service checks all others."""
    known, needed = tool.schema["properties"], tool.schema.get("required", [])
    unknown = [name for name in given if name not in known]
    if unknown:
        raise MalformedRequest(f"{tool.name} takes no {unknown[0][:64]!r}; it takes {', '.join(known) or 'nothing'}")
    missing = [name for name in needed if name not in given]
    if missing:
        raise MalformedRequest(f"{tool.name} needs {missing[0]!r}")
    for name, schema in known.items():
        if schema == {"type": "string", "description": schema.get("description")} and not isinstance(
            given.get(name, ""), str
        ):
            raise MalformedRequest(f"{name!r} of {tool.name} is a text")
