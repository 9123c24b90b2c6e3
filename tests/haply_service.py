"""A stand-in for Haply's service, on a port of its own: one answer for each message, and ways to misbehave."""

import json
import threading
import time

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

DROPS = 2000  # after which what drips gives up
_AT = '{"inverse3": [{"device_id": "049D", "state": {"cursor_position": %s}}]}'


class HaplyService:
    """Answers on `url` for devices at `place` (m), and keeps the last `force` (N) of each and all the `messages`.

    **Attributes:** `fault`: `None`, `"drips"`, an answer in small pieces without end, or one of `FAULTS`; `drops`: how many
    pieces have been sent. A force ends with its connection, as the service's does.
    """

    FAULTS = ("silence", "closed", "garbage", "nan", "nothing", "unplugged", "jump", "deep", "text", "huge")

    def __init__(self, ids=("049D",), field="values"):
        self.field, self.place, self.fault = field, np.zeros(3), None
        self.force = {name: np.zeros(3) for name in ids}
        self.messages: list[dict] = []
        self.drops = 0
        self._server = serve(self._serve, "127.0.0.1", 0)
        self.url = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exception):
        self._server.shutdown()
        self._thread.join()

    def _state(self, place):
        here = dict(zip("xyz", map(float, place), strict=True))
        return {"inverse3": [{"device_id": name, "state": {"cursor_position": here}} for name in self.force]}

    def _serve(self, connection):
        inventory = self._state(self.place)
        if self.fault == "unplugged":
            inventory = {"inverse3": []}
        try:
            if self.fault != "silence":
                connection.send(json.dumps(inventory))
            for text in connection:
                message = json.loads(text)
                self.messages.append(message)
                for device in message["inverse3"]:
                    force = device["commands"]["set_cursor_force"][self.field]
                    self.force[device["device_id"]] = np.array([force[axis] for axis in "xyz"])
                if self.fault == "closed":
                    return
                answer = self._answer()
                if answer is not None:
                    connection.send(answer)
        except ConnectionClosed:
            pass
        finally:
            self.force = {name: np.zeros(3) for name in self.force}

    def _drips(self):
        yield '{"inverse3": "'
        while self.drops < DROPS:
            time.sleep(1e-3)
            self.drops += 1
            yield "a"

    def _answer(self):
        return {
            None: lambda: json.dumps(self._state(self.place)),
            "silence": lambda: None,
            "drips": self._drips,
            "garbage": lambda: b"\xff\xfe<html>",
            "nan": lambda: json.dumps(self._state((0.0, np.nan, 0.0))),
            "nothing": lambda: "{}",
            "unplugged": lambda: '{"inverse3": []}',
            "jump": lambda: json.dumps(self._state(self.place + 0.5)),
            "deep": lambda: "[" * 100_000,
            "text": lambda: _AT % '"here"',
            "huge": lambda: _AT % f'{{"x": 1{"0" * 400}, "y": 0, "z": 0}}',
        }[self.fault]()
