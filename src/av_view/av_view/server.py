"""The web server of the page and its viewers, in a thread of its own.

Each viewer asks for the next update when it has shown the previous one; states are encoded once for all. The numbers of
holders of the token, and of others, the guests, are limited. Whoever does not ask, or does not read what it asked for, is
dropped, so that nothing piles up.
"""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from av_view.access import Access
from av_view.feed import Feed

LARGEST_REQUEST = 4096  # bytes of a viewer's message
MOST_REQUESTS = 50  # of one viewer in a second
MOST_UNREAD = 4_000_000  # bytes that wait for a viewer: several updates; a viewer asks for the next one when it has read one
PROTOCOL = Subprotocol('rig')  # a viewer offers this one, and its token as another one
MOST_HOLDERS, MOST_GUESTS = 20, 20  # beyond which others give way, or guests are refused
IDLE_S = 3.0  # after which a guest that neither asks nor waits gives way to another one
PATIENCE_S = 20.0  # after which a viewer is dropped that neither asks nor waits for an update
MOST_OPENING, OPENING_S = 256, 5.0  # connections that are no viewers (yet), and how long each may take
TIDY_S = 1.0  # much less than PATIENCE_S
READ_ONLY = 'this page is read-only: start the rig with view_control:=true'
WRONG_TOKEN = 'this page is read-only: open the address with the token of this launch'
PAGE = {'/': ('index.html', 'text/html'), '/view.css': ('view.css', 'text/css'), '/icon.svg': ('icon.svg', 'image/svg+xml'),
        **{f'/{name}.js': (f'{name}.js', 'text/javascript') for name in ('words', 'draw', 'view')}}
SECURITY = {
    'Content-Security-Policy': "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
                               "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    'X-Content-Type-Options': 'nosniff', 'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store'}
# From the name of an action, the rig and the values of the request to the answer; called in the thread of the server.
Act = Callable[[str, str, dict[str, Any]], Awaitable[dict[str, Any]]]


@dataclass(eq=False)
class _Viewer:
    connection: ServerConnection
    holds_token: bool
    rig: str | None = None  # None while there is no rig
    has_chosen: bool = False
    had: int = 0  # serial number of the newest state that it was sent
    asked: float = field(default_factory=time.monotonic)
    requests: list[float] = field(default_factory=list)


class _Connection(ServerConnection):
    """A connection that makes room for further ones until it is a viewer's."""

    opening: dict[ServerConnection, None]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Count it; beyond MOST_OPENING the oldest one that is no viewer's ends."""
        super().connection_made(transport)
        self.opening[self] = None
        if len(self.opening) > MOST_OPENING:
            oldest = next(iter(self.opening))
            del self.opening[oldest]
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it no more."""
        self.opening.pop(self, None)
        super().connection_lost(exc)


class ViewServer:
    """Serves the page, feeds of rigs to viewers, and requests of viewers to `act`. Used from one other thread.

    Attributes:
        port: TCP port, once started.
        refused: number of requests that were refused, and of viewers that were dropped.

    Parameters:
        bind_address: address of this machine.
        port: TCP port; 0 for one that is free.
        access: who may read and control.
        act: carries out requests.
    """

    def __init__(self, bind_address: str, port: int, access: Access, act: Act) -> None:
        self._bind_address, self._access, self._act = bind_address, access, act
        self._feeds: dict[str, Feed] = {}
        self._viewers: set[_Viewer] = set()
        self._waiting: dict[_Viewer, None] = {}  # for an update, the longest first
        self._opening: dict[ServerConnection, None] = {}
        self._tasks: set[asyncio.Task[None]] = set()  # of viewers that are dropped, and of requests that wait for the rig
        self._rigs: tuple[str, ...] = ()
        self._loop = asyncio.new_event_loop()
        self._server: Server | None = None
        self._files = {path: (kind, (files('av_view') / 'page' / name).read_bytes()) for path, (name, kind) in PAGE.items()}
        self._thread = threading.Thread(target=self._loop.run_forever, name='view server', daemon=True)
        self.port, self.refused = port, 0

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

    def watched(self) -> set[str | None]:
        """Namespaces of the rigs that somebody looks at; None of viewers that wait for a rig."""
        return {viewer.rig for viewer in tuple(self._viewers)}

    def put(self, change: Callable[[Feed], None], rig: str) -> None:
        """Change the feed of a rig, and send an update where there is a new state.

        Parameters:
            change: called with the feed in the thread of the server.
            rig: namespace of the rig.
        """
        self._loop.call_soon_threadsafe(self._put, change, rig)

    def set_rigs(self, rigs: tuple[str, ...]) -> None:
        """Tell viewers which rigs there are, by their namespaces; whoever has not chosen one sees the first."""
        self._loop.call_soon_threadsafe(self._set_rigs, rigs)

    def drop(self, rig: str) -> None:
        """Forget the feed of a rig that nobody looks at."""
        self._loop.call_soon_threadsafe(self._feeds.pop, rig, None)

    def _put(self, change: Callable[[Feed], None], rig: str) -> None:
        feed = self._feeds.setdefault(rig, Feed())
        change(feed)
        self._serve(feed, [viewer for viewer in self._waiting if viewer.rig == rig])

    def _serve(self, feed: Feed, waiting: Sequence[_Viewer]) -> None:
        """Send what is new to viewers of one rig that wait."""
        for viewer in waiting:
            news, viewer.had = feed.news(viewer.had), feed.serial
            if news:
                del self._waiting[viewer]
            for message in news:
                broadcast([viewer.connection], message)

    def _set_rigs(self, rigs: tuple[str, ...]) -> None:
        moved = [viewer for viewer in self._viewers if not viewer.has_chosen and viewer.rig not in rigs]
        for viewer in moved:
            viewer.rig, viewer.had = (rigs[0] if rigs else viewer.rig), 0
        self._tell_rigs(self._viewers if rigs != self._rigs else moved if rigs else (), rigs)
        self._rigs = rigs

    def _tell_rigs(self, viewers: Iterable[_Viewer], rigs: Sequence[str]) -> None:
        for viewer in viewers:
            broadcast([viewer.connection], json.dumps({
                'type': 'rigs', 'rigs': rigs, 'rig': viewer.rig, 'control': bool(self._access.token),
                'token': viewer.holds_token}))

    async def _listen(self) -> None:
        quiet = logging.getLogger('av_view.websockets')  # malformed requests are counted instead
        quiet.setLevel(logging.CRITICAL)
        connection = type('Connection', (_Connection,), {'opening': self._opening})
        self._server = await serve(
            self._serve_viewer, self._bind_address, self.port, process_request=self._answer, create_connection=connection,
            select_subprotocol=lambda _, offered: PROTOCOL if PROTOCOL in offered else None, compression=None,
            open_timeout=OPENING_S, ping_interval=PATIENCE_S, ping_timeout=PATIENCE_S, close_timeout=1.0,
            max_size=LARGEST_REQUEST, max_queue=4, logger=quiet)
        self.port = int(next(iter(self._server.sockets)).getsockname()[1])
        self._loop.call_later(TIDY_S, self._tidy)

    async def _close(self) -> None:
        if self._server is not None:
            self._server.close(close_connections=True)
            await self._server.wait_closed()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The response to a request for the page; None lets a viewer in."""
        refusal = self._access.refusal(request.headers.get_all('Host'), request.headers.get_all('Origin'))
        if refusal:
            self.refused += 1
            return _response(HTTPStatus.FORBIDDEN, 'text/plain', f'{refusal}\n'.encode())
        path = request.path.partition('?')[0]
        if path == '/feed':
            if self._has_room(self._holds_token(request)):
                return None
            self.refused += 1
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, 'text/plain', b'There are too many viewers.\n')
        if path not in self._files:
            return _response(HTTPStatus.NOT_FOUND, 'text/plain', b'There is no such page.\n')
        return _response(HTTPStatus.OK, *self._files[path])

    def _holds_token(self, request: Request | None) -> bool:
        offered = request.headers.get_all('Sec-WebSocket-Protocol') if request else []
        return any(self._access.may_control(word.strip()) for line in offered[:1] for word in line.split(',')[:2])

    def _has_room(self, holds_token: bool) -> bool:
        """Whether one more viewer of a class is let in; in place of the one that asked longest ago where there are many.

        Parameters:
            holds_token: of the class; its viewers always get room, guests only from one that is idle.
        """
        others = [viewer for viewer in self._viewers if viewer.holds_token == holds_token]
        if len(others) < (MOST_HOLDERS if holds_token else MOST_GUESTS):
            return True
        idle = [viewer for viewer in others if holds_token or
                (viewer not in self._waiting and viewer.asked < time.monotonic() - IDLE_S)]
        if idle:
            self._drop(min(idle, key=lambda viewer: viewer.asked), 'others want to look')
        return bool(idle)

    async def _serve_viewer(self, connection: ServerConnection) -> None:
        viewer = _Viewer(connection, self._holds_token(connection.request), self._rigs[0] if self._rigs else None)
        self._opening.pop(connection, None)
        self._viewers.add(viewer)
        self._tell_rigs([viewer], self._rigs)
        try:
            async for message in connection:
                self._take(viewer, message)
        except ConnectionClosed:  # also by a message that is too large
            pass
        finally:
            self._viewers.discard(viewer)
            self._waiting.pop(viewer, None)

    def _tidy(self) -> None:
        """Once a second: drop who does not ask."""
        late = time.monotonic() - PATIENCE_S
        for viewer in [one for one in self._viewers if one.asked < late and one not in self._waiting]:
            self._drop(viewer, 'asks for nothing')
        self._loop.call_later(TIDY_S, self._tidy)

    def _drop(self, viewer: _Viewer, why: str) -> None:
        self.refused += 1
        self._viewers.discard(viewer)
        self._waiting.pop(viewer, None)
        self._begin(viewer.connection.close(1008, why))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Do something beside all else."""
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _take(self, viewer: _Viewer, message: str | bytes) -> None:
        """A request of a viewer. One that cannot be used, or one too many, closes its connection."""
        if viewer not in self._viewers:
            return  # has been dropped
        viewer.asked = now = time.monotonic()
        viewer.requests = [one for one in viewer.requests if now - one < 1.0] + [now]
        request = _request(message)
        if request is None or len(viewer.requests) > MOST_REQUESTS:
            self._drop(viewer, 'not a request' if request is None else 'too many requests')
        elif viewer.connection.transport.get_write_buffer_size() > MOST_UNREAD:
            self._drop(viewer, 'does not read')
        elif request['do'] in ('next', 'watch'):
            if 'rig' in request:
                viewer.rig, viewer.has_chosen, viewer.had = str(request['rig'])[:200], True, 0
            self._waiting.setdefault(viewer)
            if viewer.rig in self._feeds:
                self._serve(self._feeds[viewer.rig], [viewer])
        else:
            self._begin(self._control(viewer, request))

    async def _control(self, viewer: _Viewer, request: dict[str, Any]) -> None:
        """Answer a request to the rig, beside others: a stop waits for no other answer."""
        answer = await self._controlled(request['do'], viewer, request)
        with suppress(ConnectionClosed):
            await viewer.connection.send(json.dumps({'type': 'answer', 'number': request.get('number'), **answer}))

    async def _controlled(self, name: str, viewer: _Viewer, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request of a viewer with the token."""
        if not viewer.holds_token:
            self.refused += 1
            return {'done': False, 'words': WRONG_TOKEN if self._access.token else READ_ONLY}
        if viewer.rig is None:
            return {'done': False, 'words': 'there is no rig'}
        try:
            return await self._act(name, viewer.rig, request)
        except (ValueError, TypeError, KeyError, TimeoutError) as error:
            return {'done': False, 'words': str(error) or 'no answer'}


def _request(message: str | bytes) -> dict[str, Any] | None:
    """The request in a viewer's message; None where it is none."""
    try:
        request = json.loads(message)
    except (ValueError, RecursionError):
        return None
    good = isinstance(request, dict) and isinstance(request.get('do'), str) and isinstance(request.get('number', 0), int)
    return request if good else None


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers({'Content-Type': f'{kind}; charset=utf-8', 'Content-Length': str(len(body)), 'Connection': 'close',
                       **SECURITY})
    return Response(status.value, status.phrase, headers, body)
