"""The text of a scene file as tables: TOML, refused where little of it would take much memory."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from .errors import InputError

LARGEST = 2**19  # bytes; a scene file is written by hand
_DOTS, _ALL_DOTS, _HEADERS = 16, 10_000, 1000  # in a line; in the file
_HEADER = re.compile(r"^[ \t]*\[\[?[ \t]*[A-Za-z_\"']", re.MULTILINE)
_BETWEEN = re.compile(r"[\s,=\[\]{}]+")
_NUMBER = re.compile(r"[+-]?[\d_]+\.[\d_]+([eE][+-]?[\d_]+)?")


def tables(data: bytes) -> dict[str, Any]:
    """The tables that TOML describes.

    **Raises:** `InputError` for what is no TOML, for integers beyond 64 bits, and for more than a scene needs of what would
    take over 20 times its room in memory.
    """
    if len(data) > LARGEST:
        raise InputError(f"has {len(data)} bytes or more; allowed: a scene file of at most {LARGEST} bytes")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"has a byte at {error.start} that is not UTF-8; allowed: a scene file in TOML"
        ) from None
    _check_room(text)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of more digits than Python reads
        raise InputError(
            f"is not TOML: {str(error) or 'nested too deep'}; allowed: a scene file in TOML"
        ) from None
    _check_integers(table, "")
    return table


def _check_room(text: str) -> None:
    """Refuse text that tomllib would need far more room for: each part of a dotted key is a table, twice, and to read one of
    a million parts takes all the memory there is."""
    everywhere = 0
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("#") or "." not in line:
            continue
        dots = sum(word.count(".") for word in _BETWEEN.split(line) if not _NUMBER.fullmatch(word))
        everywhere += dots
        if dots > _DOTS:
            raise InputError(f"line {number} has {dots} dots outside of numbers; allowed: {_DOTS} or fewer")
    if everywhere > _ALL_DOTS:
        raise InputError(f"has {everywhere} dots outside of numbers; allowed: {_ALL_DOTS} or fewer")
    headers = len(_HEADER.findall(text))
    if headers > _HEADERS:
        raise InputError(f"has {headers} tables; allowed: {_HEADERS} or fewer")


def _check_integers(value: Any, path: str) -> None:
    """Refuse integers beyond 64 bits, as TOML asks: Python reads them, and fails later in printing them."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            _check_integers(part, f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for part in value:
            _check_integers(part, path)
    elif isinstance(value, int) and value.bit_length() > 63:
        raise InputError(f"{path} is an integer of {value.bit_length()} bits; allowed: at most 63 bits")
