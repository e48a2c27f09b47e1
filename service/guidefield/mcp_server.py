"""A server of the Model Context Protocol: a language model asks for plans, a service answers, in words and figures.

It speaks over standard input and output; needs ``guidefield[mcp]``. `TOOLS` are its tools (docs/mcp.md); names,
descriptions and schemas are what models read, and none moves a robot: all are announced as reading only. `ADVICE` has a
line for each `Status` but success.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from guidefield.client import AsyncClient
from guidefield.errors import GuidefieldError, MalformedRequest, Status, UnknownObject, convert_exception
from guidefield.messages.certify_reply import describe_certificate, describe_effort, describe_speed
from guidefield.messages.replies import (
    CartesianUse,
    CertifyReply,
    ClearanceFigures,
    ClearanceReply,
    EffortFigures,
    InverseKinematicsReply,
    LimitUse,
    Outcome,
    PlanReply,
    RobotReply,
    RobotsReply,
    RunReply,
    SelfClearance,
    make_error_reply,
    to_plain_data,
)
from guidefield.messages.requests import CertifyRequest, Clearance, InverseKinematics, PlanRequest
from guidefield.messages.scene import Scene
from guidefield.messages.schemas import make_schemas_of

MOST_LINES = 20  # number of results in words at most; the figures have all of them


def describe_plan(reply: PlanReply) -> str:
    """Describe a plan: outcome, motion, clearance, certificate, and how to get the whole trajectory."""
    sentences = [_outcome(reply.status)]
    if reply.metrics is not None:
        sentences.append(
            f"The motion takes {reply.metrics.duration:.2f} s over {len(reply.path)} waypoints; the tip moves"
            f" {reply.metrics.tip_path_length:.3f} m."
        )
    sentences += [*_clearances(reply.clearance, reply.self_clearance), f"Certificate: {describe_certificate(reply)}."]
    sentences += _loads(reply.cartesian, reply.effort)
    if reply.trajectory is not None:
        sentences.append(f"`trajectory` with run_id {reply.run_id!r} gives its times, positions and velocities.")
    return _join_sentences(sentences, reply.warnings)


def describe_verdict(reply: CertifyReply) -> str:
    """Describe a verdict: free or where it is refused, clearance, and the largest use of each limit."""
    sentences = [_outcome(reply.status)]
    certificate = reply.certificate
    if not certificate.collision_free:
        sentences.append(f"It is certified until {_place(certificate.free_until.row, certificate.free_until.time)}.")
    if certificate.place is not None:
        pair = "" if certificate.pair is None else f" for {' and '.join(certificate.pair)}"
        where = _place(certificate.place.row, certificate.place.time)
        sentences.append(f"It is refused{pair}: {certificate.reason}, at {where}.")
    sentences += _clearances(reply.clearance, reply.self_clearance)
    for name in reply.limits.__struct_fields__:
        use: LimitUse = getattr(reply.limits, name)
        if use.share is not None and use.joint is not None:
            beyond = ", which is beyond it" if use.share > 1.0 else ""
            sentences.append(f"{use.joint} uses {100.0 * use.share:.1f} % of its {name} limit{beyond}.")
    return _join_sentences([*sentences, *_loads(reply.cartesian, reply.effort)], reply.warnings)


def _loads(cartesian: list[CartesianUse], effort: EffortFigures | None) -> list[str]:
    sentences = [f"{describe_speed(use)}." for use in cartesian]
    strongest = None if effort is None else describe_effort(effort)
    return sentences if strongest is None else [*sentences, f"{strongest}."]


def describe_clearance(reply: ClearanceReply) -> str:
    """Describe distances, a line for each configuration."""
    rows = zip(reply.minimum, reply.pair, reply.self_minimum, strict=True)
    lines = [
        f"Configuration {index}: {_distance(least, pair)}{_own(own)}." for index, (least, pair, own) in enumerate(rows)
    ]
    return _join_sentences(_first(lines), reply.warnings, "\n")


def describe_solutions(reply: InverseKinematicsReply) -> str:
    """Describe how many configurations reach each pose, and why none or not more do."""
    rows = enumerate(zip(reply.configurations, reply.reasons, strict=True))
    lines = [
        f"Pose {index}: {len(found) or 'no'} configuration{'' if len(found) == 1 else 's'}"
        f"{'; ' + reason if reason else ''}."
        for index, (found, reason) in rows
    ]
    if not all(reply.configurations):
        lines.append(advise(Status.NO_IK_SOLUTION))
    return _join_sentences(_first(lines), reply.warnings, "\n")


def list_robots(reply: RobotsReply) -> str:
    """List the robots, each with its degrees of freedom, and those that can't be used."""
    good = [f"{one.name} ({one.dof})" for one in reply.robots if one.problem is None]
    bad = [f"{one.name}: {one.problem}" for one in reply.robots if one.problem is not None]
    sentences = [f"{len(good)} robots, each with how many numbers its motion has: {', '.join(good)}."]
    return _join_sentences([*sentences, *(f"Can't be used: {one}." for one in bad)], [], "\n")


def describe_robot(reply: RobotReply) -> str:
    """Describe a robot: its tip, groups, and joints with their limits."""
    groups = [f"{name}: {', '.join(joints)}" for name, joints in reply.groups.items()]
    lines = [
        f"{reply.name}: goals are about the frame {reply.tip}.",
        f"Groups: {'; '.join(groups) or 'none'}.",
    ]
    for joint in reply.joints:
        if joint.mimics is not None:
            lines.append(f"{joint.name} follows {joint.mimics}.")
            continue
        ranges = ", ".join(
            f"{_limit(low, '-')} to {_limit(high, '+')}" for low, high in zip(joint.lower, joint.upper, strict=True)
        )
        lines.append(f"{joint.name} is {joint.kind}, from {ranges}; at rest it is at {reply.rest.get(joint.name)}.")
    return _join_sentences(lines, reply.warnings, "\n")


def describe_scene(scene: Scene) -> str:
    """Describe a scene: its obstacles and guide planes by name."""
    obstacles = [f"{one.name} ({one.__struct_config__.tag})" for one in scene.obstacles]
    planes = [plane.name for plane in scene.guide_planes]
    return (
        f"{scene.name}: obstacles {', '.join(_first(obstacles)) or 'none'}; guide planes {', '.join(planes) or 'none'}."
    )


def describe_error(error: GuidefieldError) -> str:
    """Describe an error: its name, what is wrong, and what to do."""
    after = error.details.get("retry_after")
    again = f" Ask again in {after:g} s." if isinstance(after, int | float) else ""
    return f"{error.code.name}: {error.message}. {advise(error.code)}{again}".strip()


def _outcome(status: Outcome) -> str:
    return f"{status.name}: {status.message}. {advise(status.code)}".strip()


def _clearances(clearance: ClearanceFigures | None, own: SelfClearance | None) -> list[str]:
    sentences = []
    if clearance is not None and clearance.minimum is not None:
        when = "" if clearance.time is None else f", at {clearance.time:.2f} s"
        sentences.append(f"To obstacles: {_distance(clearance.minimum, clearance.pair)}{when}.")
    if own is not None and own.minimum is not None:
        sentences.append(f"To itself: {_distance(own.minimum, own.pair)}.")
    return sentences


def _distance(least: float | None, pair: Iterable[str] | None) -> str:
    if least is None:
        return "there is no obstacle"
    between = "" if pair is None else f" between {' and '.join(pair)}"
    if least > 0.0:
        return f"{1e3 * least:.1f} mm{between}"
    return f"contact{between}" + (f", {-1e3 * least:.1f} mm deep" if least < 0.0 else "")


def _own(least: float | None) -> str:
    if least is None:
        return ""
    return f"; the robot keeps {1e3 * least:.1f} mm from itself" if least > 0.0 else "; the robot touches itself"


def _place(row: float, time: float | None) -> str:
    return f"row {row:.4g}" if time is None else f"{time:.3f} s (row {row:.4g})"


def _limit(value: float | None, sign: str) -> str:
    return f"{sign}infinity" if value is None else f"{value:.4g}"


def _first(lines: list[str]) -> list[str]:
    more = len(lines) - MOST_LINES
    return lines if more <= 0 else [*lines[:MOST_LINES], f"and {more} more"]


def _join_sentences(sentences: list[str], warnings: list[str], by: str = " ") -> str:
    return by.join([*sentences, *(f"Warning: {warning}." for warning in warnings)])


ADVICE = {
    Status.PLANNING_FAILED: "Give more `allowed_planning_time`, another `seed`, or a goal that is nearer or freer.",
    Status.INVALID_MOTION_PLAN: "Change the motion where it is refused, or lower `min_clearance`, or `plan` one.",
    Status.TIMED_OUT: "Give more `allowed_planning_time` (or `allowed_time`), or ask for less at once.",
    Status.PREEMPTED: "Somebody cancelled it; ask again if it is still wanted.",
    Status.START_STATE_IN_COLLISION: "Ask `clearance` at the start. If the contact is wanted, name the pair in"
    " `allowed_collisions`; if it is slight, set `leave_start_contact`.",
    Status.START_STATE_VIOLATES_PATH_CONSTRAINTS: "Widen the constraint's tolerance, or begin where it holds.",
    Status.GOAL_IN_COLLISION: "Ask `clearance` at the goal and move the goal away from that pair, or name the pair in"
    " `allowed_collisions` if it may touch.",
    Status.GOAL_VIOLATES_PATH_CONSTRAINTS: "Widen the constraint's tolerance, or take a goal where it holds.",
    Status.GOAL_CONSTRAINTS_VIOLATED: "Widen the goal's tolerances.",
    Status.INVALID_GROUP_NAME: "Ask `robot` for its groups and joints.",
    Status.INVALID_GOAL_CONSTRAINTS: "Ask `robot` for its joints, and write the goal for them.",
    Status.INVALID_ROBOT_STATE: "Ask `robot` for the names and kinds of its joints.",
    Status.INVALID_LINK_NAME: "Ask `robot` for its links and frames.",
    Status.INVALID_OBJECT_NAME: "Ask `scene` for the names of its obstacles.",
    Status.COMMUNICATION_FAILURE: "Tell the user: no service answers there. `guidefield serve` starts one.",
    Status.START_STATE_INVALID: "Ask `robot` for the joint's limits, and begin within them.",
    Status.GOAL_STATE_INVALID: "Ask `robot` for the joint's limits, and take a goal within them.",
    Status.CRASH: "Ask again; if it comes again, tell the user, whose service has a log.",
    Status.NO_IK_SOLUTION: "Ask `inverse_kinematics` with other poses or wider tolerances: the pose is out of reach, or"
    " every configuration that reaches it touches something.",
    Status.STUCK_IN_MINIMUM: "Set `guide_planes` to [] or `planner` to `tree`, or move the guide planes.",
    Status.GUIDE_PLANE_UNREACHABLE: "Move the guide plane towards the robot, or set `guide_planes` to [].",
    Status.CLEARANCE_BELOW_MINIMUM: "Lower `min_clearance`, or give more `allowed_planning_time`.",
    Status.SCENE_INVALID: "Ask `scenes` for the names, or send the scene itself.",
    Status.ROBOT_INVALID: "Ask `robots` for the names.",
    Status.SERVER_BUSY: "Wait, and ask again.",
    Status.QUOTA_EXCEEDED: "Wait as long as it says, and ask for less at once.",
    Status.NOT_ALLOWED: "Take something of your own, or tell the user: its owner can share it.",
    Status.STREAM_UNKNOWN: "Tell the user: the stream is closed or was never open; no tool here opens one.",
    Status.MALFORMED_REQUEST: "Correct the field that is named.",
    Status.REQUEST_TOO_LARGE: "Send less: fewer points, triangles or configurations.",
    Status.DISK_REFUSED: "Tell the user: the service's disk is full or can't be written.",
    Status.FAILURE: "Tell the user: this is a bug in guidefield, and the service has a log.",
}
"""Advice to the model by outcome."""


def advise(code: int) -> str:
    """Return advice about an outcome; none about a success, or an outcome of a later version."""
    return {int(status): advice for status, advice in ADVICE.items()}.get(code, "")


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
        describe_plan,
        _plan_figures,
    ),
    Tool(
        "certify",
        "Judge a motion that is given, a `path` of waypoints or a `trajectory` in time: is it free between its rows"
        " too, and within limits?",
        _schema(CertifyRequest),
        lambda client, given: client.certify({"type": "certify", **given}),
        describe_verdict,
    ),
    Tool(
        "clearance",
        "Distances of a robot to a scene's obstacles, and to itself, at configurations.",
        _schema(Clearance),
        lambda client, given: client.kinematics({"type": "clearance", **given}),
        describe_clearance,
    ),
    Tool(
        "inverse_kinematics",
        "Configurations that bring a robot's tip to poses; with `collision_free` and a scene those that touch nothing.",
        _schema(InverseKinematics),
        lambda client, given: client.kinematics({"type": "inverse_kinematics", **given}),
        describe_solutions,
    ),
    Tool("robots", "List the robots that can be named.", NOTHING, lambda client, _: client.robots(), list_robots),
    Tool(
        "robot",
        "Describe a robot: joints, limits, groups, frames, tip.",
        _named("name", "Of the robot."),
        lambda client, given: client.robot(given["name"]),
        describe_robot,
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
        describe_scene,
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
    return describe_error(failure), to_plain_data(make_error_reply(failure)), True


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
