"""The server of the Model Context Protocol, over standard input and output; needs ``guidefield[mcp]``."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from importlib.metadata import version
from pathlib import Path
from typing import Any

from guidefield.client import AsyncClient
from guidefield.errors import GuidefieldError, MalformedRequest, unforeseen
from guidefield.mcp_server.tools import TOOLS, Tool
from guidefield.mcp_server.words import error_told
from guidefield.messages.replies import as_plain_data, error_reply

INSTRUCTIONS = (
    "Plans, judges and measures motions of robots; it never moves one. Ask `robots` and `scenes` for names. A plan"
    " whose status is SUCCESS is certified: free of collisions between its samples too, and within limits. Any other"
    " status is an honest no, with its reason and what to do."
)

_log = logging.getLogger(__name__)


class Service:
    """The service that is asked, connected to when it is first needed, and again when it was not there.

    Args:
        endpoints: Where instances of it, or Zenoh routers, listen.
        instance: The only instance to ask; None: the freest.
        config: Zenoh configuration file.
        user: On whose keys it is asked; None: as the configuration says.
    """

    def __init__(self, endpoints: tuple[str, ...], instance: str | None, config: Path | None, user: str | None) -> None:
        self._where = endpoints, instance, config, user
        self._client: AsyncClient | None = None
        self._connecting = asyncio.Lock()

    async def client(self) -> AsyncClient:
        """A client that is connected.

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
    """Serve over standard input and output until the first ends.

    Args:
        endpoints: Where the service listens; none: on this machine.
        instance: The only instance to ask; None: the freest.
        config: Zenoh configuration file.
        user: On whose keys it is asked; None: as the configuration says.

    Raises:
        ImportError: if the package mcp isn't installed.
    """
    import mcp.server.stdio  # noqa: F401 - said at once where it isn't there

    asyncio.run(_serve(Service(endpoints, instance, config, user)))


async def _serve(service: Service) -> None:
    from mcp.server.stdio import stdio_server

    server = protocol_server(service)
    async with contextlib.AsyncExitStack() as opened:
        opened.push_async_callback(service.close)
        reading, writing = await opened.enter_async_context(stdio_server())
        await server.run(reading, writing, server.create_initialization_options())


def protocol_server(service: Service) -> Any:
    """The protocol's server, which asks a service.

    Args:
        service: Who is asked.
    """
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
        told, figures, failed = await _asked(service, known.get(params.name), params.name, params.arguments or {})
        return types.CallToolResult(content=[types.TextContent(text=told)], structured_content=figures, is_error=failed)

    return Server(
        "guidefield",
        version=version("guidefield"),
        instructions=INSTRUCTIONS,
        on_list_tools=list_tools,
        on_call_tool=call_tool,
    )


async def _asked(
    service: Service, tool: Tool | None, name: str, given: dict[str, Any]
) -> tuple[str, dict[str, Any], bool]:
    """What a tool answers, in words and figures, and whether that is an error; no exception leaves but cancelling."""
    try:
        if tool is None:
            raise MalformedRequest(f"there is no tool {name[:64]!r}; there are {', '.join(one.name for one in TOOLS)}")
        _refuse_other_arguments(tool, given)
        told, figures = await tool.ask(await service.client(), given)
        return told, figures, False
    except GuidefieldError as error:
        failure = error
    except Exception as error:
        _log.exception("tool %s failed by itself", name)
        failure = unforeseen(error)
    return error_told(failure), as_plain_data(error_reply(failure)), True


def _refuse_other_arguments(tool: Tool, given: dict[str, Any]) -> None:
    """Refuse arguments that the tool doesn't have, and the lack of one that it needs; the service judges the rest."""
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
