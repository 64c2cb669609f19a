"""The web server of the live page, in a thread of its own. It listens on loopback only.

Every address begins with a random token: who does not know it gets 403. Requests that name another host (DNS
rebinding) or come from another origin get 403 as well. There are no cookies.

- GET /TOKEN/ and files of the folder `page`
- GET /TOKEN/events: server-sent events `settings` (once), `rows` (new rows of the log), `message` and `status` (twice
  per second), each with a JSON value
- GET /TOKEN/layers/NAME?after=VERSION&reduction=N: the next picture of a layer (`layers.Picture`) with a version above
  `after`, once there is one; 204 if there is none for a while
- POST /TOKEN/pause, resume, stop, save: 204
"""

import asyncio
import contextlib
import hmac
import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Iterator
from importlib.resources import files

from aiohttp import web
from aiohttp.typedefs import Handler

from isonoise.errors import UserError
from isonoise.live.layers import LAYERS, MAX_REDUCTION
from isonoise.live.page_state import PageState, View

HOSTS = ("127.0.0.1", "localhost")
TICK_S = 0.5
"""Time between two `status` events."""
WAIT_S = 20.0
"""Longest wait for a picture."""
LINGER_S = 2.0
"""Longest wait for pages to take the last picture when the render has ended."""
MAX_PAGES = 16
"""Most pages that are open at a time."""
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class LiveServer:
    """Serves the page of a state until `close`.

    Parameters
    ----------
    state : PageState
        What it shows and changes.
    port : int
        0: a free one.

    Attributes
    ----------
    url : str
        Address of the page, with the token.

    Raises
    ------
    UserError
        If the port cannot be used.
    """

    def __init__(self, state: PageState, port: int = 0):
        self._state, self._token = state, secrets.token_urlsafe(24)
        self._socket = _listen(port)
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/{self._token}/"
        self._pages = 0  # open streams of events
        self._loop: asyncio.AbstractEventLoop  # set by the thread, as the events
        self._changed: asyncio.Event
        self._closing: asyncio.Event
        self._has_started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="live page", daemon=True)
        self._thread.start()
        self._has_started.wait()
        state.on_change = self._notify

    def close(self) -> None:
        """End the server once all pages have the last picture, or after `LINGER_S`."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join()

    async def _serve(self) -> None:
        self._loop, self._changed, self._closing = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
        application = web.Application(middlewares=[self._check], client_max_size=1024)
        prefix = "/{token}"
        application.add_routes(
            [
                web.get(f"{prefix}/", self._file),
                web.get(f"{prefix}/events", self._events),
                web.get(f"{prefix}/layers/{{layer}}", self._layer),
                web.get(f"{prefix}/{{file}}", self._file),
                web.post(f"{prefix}/{{command}}", self._command),
            ]
        )
        runner = web.AppRunner(application, handle_signals=False, access_log=None, shutdown_timeout=0.2)
        await runner.setup()
        await web.SockSite(runner, self._socket).start()
        self._has_started.set()
        await self._closing.wait()
        end = time.monotonic() + LINGER_S
        while self._pages and time.monotonic() < end:
            await asyncio.sleep(0.02)
        await runner.cleanup()

    def _notify(self) -> None:
        """Wake all requests that wait. Called by the thread that renders."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        waiting, self._changed = self._changed, asyncio.Event()
        waiting.set()

    async def _wait(self, request: web.Request, seconds: float = TICK_S) -> bool:
        """Wait for a change, at most so long; whether the page is still there."""
        self._state.server_cpu_s = time.thread_time()
        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):  # one and the same from Python 3.11 on
            await asyncio.wait_for(self._changed.wait(), seconds)
        return request.transport is not None and not request.transport.is_closing()

    @web.middleware
    async def _check(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer only requests to this host, from its own pages, with the token."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        token = request.path.partition("/")[2].partition("/")[0]
        is_own = host.rpartition(":")[0] in HOSTS and origin in (None, f"http://{host}")
        if not is_own or not hmac.compare_digest(token.encode(), self._token.encode()):
            return web.Response(status=403, text="403: open the address that isonoise has printed", headers=_HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"{error.status}: {error.reason}", headers=_HEADERS)
        if not response.prepared:
            response.headers.update(_HEADERS)
        return response

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info.get("file", "index.html")
        file = files("isonoise.live") / "page" / name
        kind = _TYPES.get(name[name.rfind(".") :])
        if kind is None or "/" in name or "\\" in name or not file.is_file():
            raise web.HTTPNotFound
        return web.Response(body=file.read_bytes(), content_type=kind, charset="utf-8")

    async def _command(self, request: web.Request) -> web.Response:
        command, state = request.match_info["command"], self._state
        if command in ("pause", "resume"):
            state.is_paused = command == "pause"
        elif command == "stop":
            state.wants_stop = True
        elif command == "save" and (state.settings() or {}).get("can_save"):
            state.wants_save = True
        else:
            raise web.HTTPNotFound
        self._wake()
        return web.Response(status=204)

    async def _layer(self, request: web.Request) -> web.Response:
        """The next picture of a layer."""
        try:
            after, reduction = int(request.query.get("after", -1)), int(request.query.get("reduction", 1))
        except ValueError:
            raise web.HTTPBadRequest from None
        view = View(request.match_info["layer"], reduction)
        if view.layer not in LAYERS:
            raise web.HTTPNotFound
        if not 1 <= reduction <= MAX_REDUCTION:
            raise web.HTTPBadRequest
        end = time.monotonic() + WAIT_S
        while (picture := self._state.picture(view, after)) is None:
            if self._state.has_ended or time.monotonic() > end:
                return web.Response(status=204)
            self._state.look(view, after)
            if not await self._wait(request):
                return web.Response(status=204)
        data = await asyncio.get_running_loop().run_in_executor(None, picture.data)
        return web.Response(body=data, content_type="application/octet-stream")

    async def _events(self, request: web.Request) -> web.StreamResponse:
        with self._open_page():
            response = web.StreamResponse(headers=_HEADERS | {"Content-Type": "text/event-stream"})
            await response.prepare(request)
            state, has_settings, rows, messages = self._state, False, 0, 0
            while True:
                has_ended = state.has_ended
                events: list[tuple[str, object]] = []
                if not has_settings and state.settings():
                    has_settings = True
                    events.append(("settings", state.settings()))
                if new_rows := state.rows(rows):
                    rows += len(new_rows)
                    events.append(("rows", new_rows))
                new_messages = state.messages(messages)
                messages += len(new_messages)
                events += [("message", message) for message in new_messages]
                events.append(("status", state.status()))
                try:
                    await response.write(b"".join(_event(*event) for event in events))
                    is_there = await self._wait(request)
                    while has_ended and is_there:  # it goes when it has the last picture
                        is_there = await self._wait(request, LINGER_S / 100)
                except ConnectionError:
                    is_there = False
                if not is_there:
                    return response

    @contextlib.contextmanager
    def _open_page(self) -> Iterator[None]:
        """Count an open page."""
        if self._pages >= MAX_PAGES:
            raise web.HTTPServiceUnavailable
        self._pages += 1
        try:
            yield
        finally:
            self._pages -= 1


def _event(name: str, value: object) -> bytes:
    return f"event: {name}\ndata: {json.dumps(value)}\n\n".encode()


def _listen(port: int) -> socket.socket:
    result = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere it would let another process take the port
            result.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        result.bind(("127.0.0.1", port))
        result.listen(128)
    except OSError as error:
        result.close()
        raise UserError(
            f"--serve: port {port} cannot be used ({error.strerror}); give another one, or none for a free one"
        ) from error
    return result
