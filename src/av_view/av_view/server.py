"""The web server of the page and its viewers, in a thread of its own.

Each viewer asks for the next message when it has shown the previous one: a slow one gets fewer, and nothing piles up for one
that stalls. All viewers together are sent at most `most_updates` a second, so that many cost no more than some.
"""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from av_view.access import Access
from av_view.feed import Feed, Position

LARGEST_REQUEST = 4096  # bytes of a viewer's message
MOST_REQUESTS = 50  # of one viewer in a second
PING_S = 15.0  # a viewer that answers no ping for as long again is gone
READ_ONLY = 'this page is read-only: start the rig with view_control:=true'
WRONG_TOKEN_S = 1.0  # delay of the answer to a wrong token
PAGE = {'/': ('index.html', 'text/html'), '/view.css': ('view.css', 'text/css'), '/icon.svg': ('icon.svg', 'image/svg+xml'),
        '/view.js': ('view.js', 'text/javascript'), '/draw.js': ('draw.js', 'text/javascript')}
SECURITY = {
    'Content-Security-Policy': "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
                               "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    'X-Content-Type-Options': 'nosniff', 'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store'}
# From the name of an action, the rig and the values of the request to the answer; called in the thread of the server.
Act = Callable[[str, str, dict[str, Any]], Awaitable[dict[str, Any]]]


@dataclass(frozen=True)
class ServerSettings:
    """Where the server listens and what it gives.

    Parameters:
        bind_address: address of this machine.
        port: TCP port; 0 for one that is free.
        rate (Hz): most updates a second for one viewer.
        most_updates (Hz): for all viewers together.
        most_viewers: further ones are refused.
        rig: namespace of the rig that viewers see first.
    """

    bind_address: str = '127.0.0.1'
    port: int = 8780
    rate: float = 10.0
    most_updates: float = 60.0
    most_viewers: int = 300
    rig: str = ''


@dataclass(eq=False)
class _Viewer:
    rig: str
    position: Position = field(default_factory=Position)
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    requests: list[float] = field(default_factory=list)


class ViewServer:
    """Serves the page, feeds of rigs to viewers, and requests of viewers to `act`. Used from one other thread.

    Attributes:
        port: TCP port, once started.
        refused: number of requests that were refused.

    Parameters:
        settings: see `ServerSettings`.
        access: who may read and control.
        act: carries out a request; see `Act`.

    `start` raises OSError where the address cannot be bound.
    """

    def __init__(self, settings: ServerSettings, access: Access, act: Act) -> None:
        self._settings, self._access, self._act = settings, access, act
        self._feeds: dict[str, Feed] = {}
        self._viewers: set[_Viewer] = set()
        self._rigs: tuple[str, ...] = ()
        self._changed: asyncio.Future[None] | None = None
        self._loop = asyncio.new_event_loop()
        self._server: Server | None = None
        self._files = {path: (kind, (files('av_view') / 'page' / name).read_bytes()) for path, (name, kind) in PAGE.items()}
        self._thread = threading.Thread(target=self._run, name='view server', daemon=True)
        self.port, self.refused = settings.port, 0

    def start(self) -> None:
        """Listen."""
        self._thread.start()
        try:
            asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        except OSError:
            self.stop()
            raise

    def stop(self) -> None:
        """Close all connections and end the thread."""
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return len(self._viewers)

    def watched(self) -> set[str]:
        """Namespaces of the rigs that somebody looks at."""
        return {viewer.rig for viewer in tuple(self._viewers)}

    def put(self, change: Callable[[Feed], None], rig: str) -> None:
        """Change the feed of a rig.

        Parameters:
            change: called with the feed in the thread of the server.
            rig: namespace of the rig.
        """
        self._loop.call_soon_threadsafe(self._put, change, rig)

    def set_rigs(self, rigs: tuple[str, ...]) -> None:
        """Tell viewers which rigs there are, by their namespaces."""
        self._rigs = rigs

    def drop(self, rig: str) -> None:
        """Forget the feed of a rig that nobody looks at."""
        self._loop.call_soon_threadsafe(self._feeds.pop, rig, None)

    def _put(self, change: Callable[[Feed], None], rig: str) -> None:
        change(self._feeds.setdefault(rig, Feed()))
        if self._changed is not None and not self._changed.done():
            self._changed.set_result(None)
        self._changed = None

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()

    async def _listen(self) -> None:
        quiet = logging.getLogger('av_view.websockets')  # malformed requests are counted instead
        quiet.setLevel(logging.CRITICAL)
        self._server = await serve(
            self._serve_viewer, self._settings.bind_address, self._settings.port, process_request=self._answer,
            compression=None, open_timeout=10.0, ping_interval=PING_S, ping_timeout=PING_S, close_timeout=1.0,
            max_size=LARGEST_REQUEST, max_queue=4, logger=quiet)
        self.port = int(next(iter(self._server.sockets)).getsockname()[1])

    async def _close(self) -> None:
        if self._server is not None:
            self._server.close(close_connections=True)
            await self._server.wait_closed()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The response to a request for the page; None lets a viewer in."""
        refusal = self._access.refusal(request.headers.get_all('Host'), request.headers.get_all('Origin'))
        if refusal:
            self.refused += 1
            return _response(HTTPStatus.FORBIDDEN, 'text/plain', f'{refusal}\n'.encode())
        path = request.path.partition('?')[0]
        if path == '/feed':
            if len(self._viewers) < self._settings.most_viewers:
                return None
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, 'text/plain', b'There are too many viewers.\n')
        if path not in self._files:
            return _response(HTTPStatus.NOT_FOUND, 'text/plain', b'There is no such page.\n')
        return _response(HTTPStatus.OK, *self._files[path])

    async def _serve_viewer(self, connection: ServerConnection) -> None:
        viewer = _Viewer(self._settings.rig)
        self._viewers.add(viewer)
        sender = asyncio.create_task(self._send(connection, viewer))
        try:
            async for message in connection:
                await self._take(connection, viewer, message)
        except ConnectionClosed:  # also by a message that is too large
            pass
        finally:
            self._viewers.discard(viewer)
            sender.cancel()

    async def _send(self, connection: ServerConnection, viewer: _Viewer) -> None:
        """Send what is new whenever the viewer is ready for it."""
        sent_rigs: tuple[str, ...] | None = None
        try:
            while True:
                await viewer.ready.wait()
                if self._rigs != sent_rigs:
                    sent_rigs = self._rigs
                    await connection.send(json.dumps(
                        {'type': 'rigs', 'rigs': sent_rigs, 'rig': viewer.rig, 'control': bool(self._access.token)}))
                messages = viewer.position.take(self._feeds.get(viewer.rig, Feed()))
                if messages:
                    viewer.ready.clear()
                    for message in messages:  # after the last one, the state, the viewer asks for the next
                        await connection.send(message)
                    await asyncio.sleep(max(1.0 / self._settings.rate, len(self._viewers) / self._settings.most_updates))
                else:
                    await self._change()
        except ConnectionClosed:
            pass

    async def _change(self) -> None:
        """Wait for a change of any feed."""
        if self._changed is None:
            self._changed = self._loop.create_future()
        await asyncio.wait([self._changed], timeout=1.0)

    async def _take(self, connection: ServerConnection, viewer: _Viewer, message: str | bytes) -> None:
        """A request of a viewer. One that cannot be used, or one too many, closes its connection."""
        now = time.monotonic()
        viewer.requests = [one for one in viewer.requests if now - one < 1.0] + [now]
        request = _request(message)
        if request is None or len(viewer.requests) > MOST_REQUESTS:
            self.refused += 1
            await connection.close(1008, 'not a request' if request is None else 'too many requests')
        elif request['do'] == 'next':
            viewer.ready.set()
        elif request['do'] == 'watch':
            viewer.rig, viewer.position = str(request.get('rig', ''))[:200], Position()
            viewer.ready.set()
        else:
            answer = await self._controlled(request['do'], viewer.rig, request)
            await connection.send(json.dumps({'type': 'answer', 'number': request.get('number'), **answer}))

    async def _controlled(self, name: str, rig: str, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request of a viewer with the token."""
        if not self._access.may_control(request.get('token')):
            self.refused += 1
            await asyncio.sleep(WRONG_TOKEN_S)
            return {'done': False, 'words': 'the token is wrong' if self._access.token else READ_ONLY}
        try:
            return await self._act(name, rig, request)
        except (ValueError, TypeError, KeyError, TimeoutError) as error:
            return {'done': False, 'words': str(error) or 'no answer'}


def _request(message: str | bytes) -> dict[str, Any] | None:
    """The request in a viewer's message; None where it is none."""
    try:
        request = json.loads(message)
    except (ValueError, RecursionError):
        return None
    return request if isinstance(request, dict) and isinstance(request.get('do'), str) else None


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers({'Content-Type': f'{kind}; charset=utf-8', 'Content-Length': str(len(body)), 'Connection': 'close',
                       **SECURITY})
    return Response(status.value, status.phrase, headers, body)
