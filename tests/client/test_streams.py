"""A client's stream that isn't open says so, before anything is sent."""

import asyncio
from typing import Any, cast

import pytest

from guidefield.client.asynchronous import AsyncServiceStream
from guidefield.client.exchange import Exchange
from guidefield.client.streams import ServiceStream
from guidefield.errors import StreamUnknown

ASKED: dict[str, Any] = {"robot": "ur5", "scene": "table"}
NOBODY = cast(Exchange, None)


def test_one_that_was_never_opened_says_how_it_is() -> None:
    stream = ServiceStream(NOBODY, ASKED, {}, None)
    for ask in (stream.update, lambda: stream.at(0.0), lambda: list(stream)):
        with pytest.raises(StreamUnknown, match="isn't open yet: `with` opens it, for asyncio `async with`"):
            ask()
    stream.close()


def test_the_same_for_asyncio() -> None:
    async def go() -> None:
        stream = AsyncServiceStream(NOBODY, ASKED, {}, None)
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            await stream.update()
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            stream.at(0.0)
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            async for _ in stream:
                pass
        await stream.close()

    asyncio.run(go())
