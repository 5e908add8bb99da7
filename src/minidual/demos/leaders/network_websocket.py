"""The door for programs that lead over a WebSocket."""

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin

from minidual.config.leading import NetworkConfig
from minidual.demos.leaders.network_door import (
    MESSAGE_MAX_BYTES,
    PER_READ_MAX,
    Door,
    Parcel,
    cannot_listen,
)

_ANSWERS_N = 16
"""Answers that wait for a program that does not read; older ones make room."""
_CLOSE_S = 1.0
_LOGGER = logging.getLogger("minidual.network")
"""Keeps failed handshakes off the terminal."""
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False


class WebSocketDoor(Door):
    """One message a frame, text or binary.

    A thread receives and sends, so that a slow program never holds up the arms. Browsers let any page
    connect to this machine: a connection that names an Origin needs one of `origins`.

    Raises:
        EnvironmentMissingError: The port is taken, or the interface does not exist.
    """

    def __init__(self, config: NetworkConfig) -> None:
        self._config = config
        self._parcels: deque[Parcel] = deque(maxlen=PER_READ_MAX)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever,
            name="network leader",
            daemon=True,
        )
        self._thread.start()
        try:
            opening = asyncio.run_coroutine_threadsafe(self._opened(), self._loop)
            self._server = opening.result()
        except OSError as error:
            self._end_thread()
            raise cannot_listen(config, "TCP", error) from error
        self.port: int = next(iter(self._server.sockets)).getsockname()[1]

    async def _opened(self) -> Server:
        allowed = [Origin(origin) for origin in self._config.origins]
        return await serve(
            self._receive,
            self._config.host,
            self._config.port,
            origins=[None, *allowed],
            compression=None,
            max_size=MESSAGE_MAX_BYTES,
            close_timeout=_CLOSE_S,
            logger=_LOGGER,
        )

    async def _receive(self, connection: ServerConnection) -> None:
        """Keep the messages of a program until the leader reads them."""
        answers: deque[str] = deque(maxlen=_ANSWERS_N)
        is_answered = asyncio.Event()
        answer = self._answering(answers, is_answered)
        sender = asyncio.create_task(_send(connection, answers, is_answered))
        try:
            async for message in connection:
                data = message.encode() if isinstance(message, str) else message
                self._parcels.append(Parcel(data, answer))
        except ConnectionClosed:  # without a farewell
            return
        finally:
            sender.cancel()

    def _answering(self, answers: deque[str], is_answered: asyncio.Event) -> Callable[[str], bool]:
        def answer(text: str) -> bool:
            answers.append(text)
            try:
                self._loop.call_soon_threadsafe(is_answered.set)
            except RuntimeError:  # the door is closed
                return False
            return True

        return answer

    def parcels(self) -> Iterator[Parcel]:
        """See `Door`."""
        for _ in range(len(self._parcels)):
            yield self._parcels.popleft()

    def close(self) -> None:
        """See `Door`."""
        asyncio.run_coroutine_threadsafe(self._closed(), self._loop).result()
        self._end_thread()

    async def _closed(self) -> None:
        self._server.close()
        await self._server.wait_closed()

    def _end_thread(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _send(
    connection: ServerConnection,
    answers: deque[str],
    is_answered: asyncio.Event,
) -> None:
    """Send answers as they come, until the connection ends."""
    while True:
        await is_answered.wait()
        is_answered.clear()
        while answers:
            try:
                await connection.send(answers.popleft())
            except ConnectionClosed:
                return
