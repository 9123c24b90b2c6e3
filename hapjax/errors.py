"""The one exception of hapjax that a user's input can cause."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Bad input. The message is one sentence: the file, field or channel, the value, and the allowed range."""


@contextmanager
def within(prefix: str) -> Iterator[None]:
    """Put `prefix` (a file's name, the path of an enclosing part) before what a refusal inside the block names."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{prefix}{error}") from None
