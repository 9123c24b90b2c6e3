"""Signals that end a process, taken where no finger is left pushed for them."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Ctrl-Z too: a loop that is suspended leaves its last forces on.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP")
ENDING = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))


class Ending:
    """While it is entered, a signal that would end or suspend the process raises `SystemExit` with 128 + its number,
    and Ctrl-C `KeyboardInterrupt`.

    In the block of `between` that waits for the next call of what the block is given, so that no device is left in the
    middle of a message; a second signal, for a loop that hangs, does not wait. From that block's end on everything is let
    go first. Signals for which the program has a handler of its own stay as they are, and so does all outside of the main
    thread, where Python takes no signals.
    """

    def __init__(self):
        self._before: dict[int, Any] = {}
        self._asked: list[int] = []
        self._waits, self._letting_go = False, False

    def __enter__(self) -> "Ending":
        if threading.current_thread() is threading.main_thread():
            for number in ENDING:
                if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                    self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, kind, error, trace) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._asked and error is None:
            raise _exception(self._asked[0])

    @contextmanager
    def between(self) -> Iterator[Callable[[], None]]:
        """A block that is only ended where it calls what it is given."""
        self._waits = True
        try:
            yield self._check
        finally:
            self._letting_go = True

    def _check(self) -> None:
        if self._asked:
            raise _exception(self._asked[0])

    def _ask(self, number: int, frame: object) -> None:
        self._asked.append(number)
        if not self._letting_go and (len(self._asked) > 1 or not self._waits):
            raise _exception(number)


def _exception(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
