"""The web server of a viewer: where it listens, and how its page looks."""

import http
import io
import ipaddress
import socket
from collections import deque
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import numpy as np
import viser
import websockets.asyncio.server as sockets

from .process import check

FIELD_OF_VIEW = 0.75  # rad
_AHEAD = 2  # batches that may be under way to a page


@contextmanager
def serving(title: str, host: str, port: int, camera: tuple[np.ndarray, np.ndarray]) -> Iterator[Any]:
    """A viser server at an address, until the block ends; says on stdout where it is.

    **Arguments:** `title` of its panel; `port`, 0: any that is free; `camera`: where it is at first and what it looks at, m.

    **Raises:** `InputError` where that cannot be listened at.
    """
    check(host, port)
    # It would say where, in a box, and at its end that it stops.
    with redirect_stdout(io.StringIO()), _guarded(host):
        server = viser.ViserServer(host, port, verbose=False)
    try:
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.gui.set_panel_label(title)
        server.gui.main_panel.dock_right()
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.set_up_direction("+z")
        server.initial_camera.position, server.initial_camera.look_at = camera
        server.initial_camera.fov, server.initial_camera.near = FIELD_OF_VIEW, 1e-3
        shown = f"[{host}]" if ":" in host else host
        print(f"the viewer is at http://{shown}:{server.get_port()}", flush=True)
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


@contextmanager
def _guarded(host: str) -> Iterator[None]:
    """A server that starts in the block answers its own pages only, see `is_own`, each at the pace of the page.

    viser asks no page where it comes from, and a browser lets any page of the web open a websocket to 127.0.0.1.
    """
    serve, guarded = sockets.serve, []

    def serve_own(handler: Any, *address: Any, process_request: Any, **options: Any) -> Any:
        def refuse(connection: Any, request: Any) -> Any:
            if is_own(request.headers.get("Origin"), request.headers.get("Host"), host):
                return process_request(connection, request)
            return connection.respond(http.HTTPStatus.FORBIDDEN, "This server answers its own pages only.\n")

        guarded.append(True)
        return serve(handler, *address, process_request=refuse, create_connection=_Paced, **options)

    with patch.object(sockets, "serve", serve_own):
        yield
    assert guarded, (
        f"viser {viser.__version__} listens in a way of its own, where pages of others are not refused"
    )


class _Paced(sockets.ServerConnection):
    """A connection on which nothing is sent before all but the newest batches have arrived: where a page is slow, or far
    away, what waits in the network would be seen seconds late; viser sends the newest alone of what waits here."""

    def __init__(self, *arguments: Any, **options: Any):
        super().__init__(*arguments, **options)
        self._under_way: deque[Awaitable[float]] = deque()

    async def send(self, message: Any, text: bool | None = None) -> None:
        while len(self._under_way) >= _AHEAD:
            await self._under_way.popleft()
        await super().send(message, text)
        self._under_way.append(await self.ping())


def is_own(origin: str | None, asked: str | None, host: str) -> bool:
    """Whether a request comes from the page of this server, or from no page at all.

    **Arguments:** what the browser says: the `origin` of the page, and what server it `asked`; the `host` that is listened
    at.

    A name of another's can be made to lead here, so it takes an address, or a name that is this computer's own.
    """
    if origin is None:
        return True
    try:
        page = urlsplit(origin)
        name = page.hostname or ""
        if name not in ("localhost", host, socket.gethostname().lower()):
            ipaddress.ip_address(name)
    except ValueError:
        return False
    return page.netloc == asked
