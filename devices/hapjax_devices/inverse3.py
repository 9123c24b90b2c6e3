"""The driver of a Haply Inverse3, through the vendor's service on this computer."""

import errno
import json
import select
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal
from urllib.parse import urlsplit

import numpy as np
from jaxtyping import Float

from hapjax import InputError
from hapjax.extras import need

from .device import DeviceError
from .driver import Driver, State
from .placement import Placement
from .realtime import Clock

URL = "ws://localhost:10001"
RESOLUTION = 1e-5  # m
FORCE_LIMIT = 5.0  # N, unless another is given
_OPENING = 1.0  # s for TCP and the websocket's handshake
_SHAKE = 0.005  # s for them after a fault, for a loop waits; for the rest of a message, and to send one
_INVENTORY = 1_000_000_000  # ns until the service has said what is attached
_PATIENCE = 2_000_000  # ns that an overdue reply is waited for
_MESSAGES = 8  # in one tick
_FASTEST, _JITTER = 4.0e-9, 2e-3  # m/ns and m: no hand moves faster, even where a clock is late
_FIELD = {"3.1": "values", "3.5": "vector"}  # what the service's message format calls the force


def attached_inverse3(url: str = URL) -> list[str]:
    """The ids of the Inverse3 that Haply's service at `url` knows of.

    **Raises:** `DeviceError` where there is no service; `InputError` where the extra `inverse3` is not installed.
    """
    connection = _connected(url, _OPENING, "an Inverse3")
    try:
        connection.sock.give(_OPENING)
        return _ids(_parsed(connection.recv_data()[1]))
    except (OSError, need("websocket", "inverse3").WebSocketException) as error:
        raise DeviceError(f"Haply's service at {url} does not say which Inverse3 are attached") from error
    finally:
        connection.shutdown()


class Inverse3(Driver):
    """A Haply Inverse3; see `Device` and `RecoverableDevice`. Needs the extra `inverse3`, and Haply's service running.

    Its own frame is the service's: right-handed, its origin in the mounting plate. The service answers every force with a
    position, and lets the device go when no more forces come.

    **Arguments:**

    - `device_id`, such as `"049D"`, where several are attached; `None`: the only one.
    - `placement` of its own frame in the world.
    - `force_limit`: the largest norm of a force, N, above 0.
    - `message_format` of the service: `"3.1"` or `"3.5"`.
    - `url` of the service; `clock`: for tests, `None` is the computer's own.

    **Attributes:** `state`: `"closed"`, `"connecting"`, `"running"` or `"faulted"`; `fault`, the sentence that says what
    went wrong, else `None`; `output` (3,) N, the force that it puts out, in the world.

    **Raises:** `InputError` for a `force_limit` out of range.
    """

    resolution = RESOLUTION

    def __init__(
        self,
        device_id: str | None = None,
        placement: Placement | None = None,
        force_limit: float = FORCE_LIMIT,
        message_format: Literal["3.1", "3.5"] = "3.1",
        url: str = URL,
        clock: Clock | None = None,
    ):
        if not 0 < force_limit < np.inf:
            raise InputError(f"force_limit is {force_limit} N; allowed: above 0")
        super().__init__(clock)
        self._websocket = need("websocket", "inverse3")
        self.force_limit, self._url, self._field = force_limit, url, _FIELD[message_format]
        self._wanted = device_id
        self.name = "the Inverse3" if device_id is None else f"the Inverse3 {device_id}"
        placement = placement or Placement()
        self._rotation, self._origin = placement.rotation(), np.asarray(placement.position)
        self._connection: Any = None
        self._address: tuple[str, int] | None = None  # which a name was looked up to be, when it was opened
        self._id: str | None = None  # of the device that this connection drives

    # The way to a running device ------------------------------------------------------------------------------

    def _steps(self) -> Iterator[State]:
        opening = self._way is None
        patience, address = (_OPENING, None) if opening else (_SHAKE, self._address)
        yield "connecting"
        self._connection = _connected(self._url, patience, self.name, address)
        self._sock = self._connection.sock
        self._address = self._sock.getpeername()[:2]
        until = self._clock.now() + _INVENTORY
        while not (messages := self._received(1_000_000)):
            yield "connecting"
            if self._clock.now() > until:
                raise DeviceError(
                    f"{self.name} cannot be found: Haply's service does not say what is attached"
                )
        self._id = self._chosen(messages[-1])
        self._taken, self._overdue, self._force = self._clock.now(), False, np.zeros(3)
        self._place = None
        self._send(np.zeros(3))
        while self._place is None:
            if self._clock.now() > until:
                raise DeviceError(f"{self.name} does not answer: no position came in a second")
            for message in self._received(1_000_000):
                self._take(message)
            yield "connecting"

    def _chosen(self, inventory: Any) -> str:
        """The id of the device that is meant, of those that the service has."""
        ids = _ids(inventory)
        if not ids:
            raise DeviceError(f"{self.name} is not attached: Haply's service knows of none")
        if self._wanted is None and len(ids) > 1:
            raise DeviceError(
                f"{len(ids)} Inverse3 are attached; say which is meant by its id: {', '.join(ids)}"
            )
        if self._wanted not in (None, *ids):
            raise DeviceError(f"{self.name} is not attached; attached: {', '.join(ids)}")
        return self._wanted or ids[0]

    # Running --------------------------------------------------------------------------------------------------

    def _read(self) -> Float[np.ndarray, "3"]:
        self._take_reply()
        return self._rotation @ self._place + self._origin

    def _write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        size = float(np.sqrt(force @ force))
        if size > self.force_limit:
            force = force * ((1 - 1e-12) * self.force_limit / size)
        self._send(force @ self._rotation)
        return force

    def _release(self) -> None:
        connection = self._connection
        if connection is None:
            return
        if self._id is not None:
            with suppress(DeviceError):
                self._send(np.zeros(3))
        self._connection = self._id = None
        with suppress(OSError, self._websocket.WebSocketException):
            connection.send_close()
        connection.shutdown()

    def _take_reply(self) -> None:
        """Move on to the newest reply; the second time in a row that there is none is a fault."""
        patient = self._overdue or not self._waiting
        if not self._waiting:
            self._send(self._force)
        until = self._clock.now() + _PATIENCE
        while True:
            wait = max(until - self._clock.now(), 0) if patient else 0
            if any([self._take(message) for message in self._received(wait)]):
                self._overdue = self._waiting = False
                return
            if not patient or self._clock.now() >= until:
                break
        if self._overdue:
            raise DeviceError(f"{self.name} does not answer: no message that makes sense came in two ticks")
        self._overdue = True

    def _take(self, message: Any) -> bool:
        """Whether a message says where the device is; if so, it is there."""
        devices = message.get("inverse3") if isinstance(message, dict) else None
        if not isinstance(devices, list):
            return False
        mine = [
            device for device in devices if isinstance(device, dict) and device.get("device_id") == self._id
        ]
        if not mine:
            raise DeviceError(
                f"{self.name} is not attached any more: Haply's service does not know {self._id}"
            )
        try:
            position = mine[0]["state"]["cursor_position"]
            place = np.array([float(position[axis]) for axis in "xyz"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return False
        now = self._clock.now()
        if self._place is not None:
            most = _JITTER + _FASTEST * (now - self._taken)
            if not np.abs(place - self._place).max() <= most:
                return False
        if not np.abs(place).max() < 2:  # NaN too, or out of any arm's reach
            return False
        self._place, self._taken = place, now
        return True

    def _send(self, force: Float[np.ndarray, "3"]) -> None:
        """Send a force in the device's frame, which the service answers with where the device is."""
        self._force, self._waiting = force, True
        values = dict(zip("xyz", force.tolist(), strict=True))
        command = {"device_id": self._id, "commands": {"set_cursor_force": {self._field: values}}}
        try:
            self._sock.give(_SHAKE)
            self._connection.send(json.dumps({"inverse3": [command]}))
        except (OSError, self._websocket.WebSocketException) as error:
            raise self._gone() from error

    def _received(self, wait: int) -> list[Any]:
        """The messages that have come, oldest first, after a wait of so many ns at most for the first; `None` for one that
        is no JSON."""
        websocket, messages, seconds = self._websocket, [], wait * 1e-9
        try:
            while len(messages) < _MESSAGES and select.select([self._sock], [], [], seconds)[0]:
                self._sock.give(_SHAKE)
                messages.append(_parsed(self._connection.recv_data()[1]))
                seconds = 0.0
        except websocket.WebSocketTimeoutException:
            pass  # a part of a message: the rest comes later
        except (OSError, ValueError, websocket.WebSocketException) as error:
            raise self._gone() from error
        return messages

    def _gone(self) -> DeviceError:
        return DeviceError(f"{self.name} is lost: Haply's service has closed the connection")


def _parsed(data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


class _Socket(socket.socket):
    """A connection that sends and receives for so long as it is given, in however small pieces."""

    _until = 0.0

    def give(self, seconds: float) -> None:
        """All calls from now on wait for so many s, together."""
        self._until = time.monotonic() + seconds

    def recv(self, *arguments: Any) -> bytes:
        """See `socket.socket`."""
        with self._in_time():
            return super().recv(*arguments)

    def send(self, *arguments: Any) -> int:
        """See `socket.socket`."""
        with self._in_time():
            return super().send(*arguments)

    @contextmanager
    def _in_time(self) -> Iterator[None]:
        self.settimeout(max(self._until - time.monotonic(), 0.0))
        try:
            yield
        except BlockingIOError:  # there is no time left to wait in
            raise TimeoutError("timed out") from None


def _connected(url: str, seconds: float, name: str, address: tuple[str, int] | None = None) -> Any:
    """A connection to the service, at an `address` where one is known: to look a name up may take long."""
    websocket, until = need("websocket", "inverse3"), time.monotonic() + seconds
    try:
        found = socket.create_connection(address or _address(url), seconds)
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock = _Socket(fileno=found.detach())
        sock.give(until - time.monotonic())
        try:
            return websocket.create_connection(url, socket=sock, redirect_limit=0, skip_utf8_validation=True)
        except BaseException:
            sock.close()
            raise
    except (OSError, websocket.WebSocketException) as error:
        refused = isinstance(error, OSError) and error.errno == errno.ECONNREFUSED
        said = "no program listens there" if refused else str(error) or type(error).__name__
        raise DeviceError(f"{name} needs Haply's service at {url}: {said}") from error


def _address(url: str) -> tuple[str, int]:
    """Host and port of a URL. **Raises:** `InputError` where it has none."""
    with suppress(ValueError):
        parts = urlsplit(url)
        if parts.scheme == "ws" and parts.hostname:
            return parts.hostname, parts.port or 80
    raise InputError(f"url of Haply's service is {url!r}; allowed: ws://HOST:PORT")


def _ids(inventory: Any) -> list[str]:
    """Those of the devices that the service's first message lists."""
    devices = inventory.get("inverse3") if isinstance(inventory, dict) else None
    if not isinstance(devices, list):
        return []
    ids = [device.get("device_id") for device in devices if isinstance(device, dict)]
    return [name for name in ids if isinstance(name, str)]
