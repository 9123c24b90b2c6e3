"""The text of a file that a user writes as tables: TOML, refused where little of it would take much memory."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import InputError

LARGEST = 2**19  # bytes; a scene file is written by hand
_DOTS = 16  # in a line
# Several times what the largest scene has. What tomllib takes beside 20 times the size of a text within them is below 16 MB.
_MOST = {"dots outside of numbers": 4000, "tables": 2000, "keys": 10_000, "lists": 50_000}
_HEADER = re.compile(r"""^[ \t]*\[\[?[ \t]*([A-Za-z_"']|[^,\[\]]*\]\]?[ \t\r]*(#.*)?$)""", re.MULTILINE)
_REMARK = re.compile(r"^[ \t]*#.*", re.MULTILINE)
# As a value: what is before an equals sign or a further dot is a part of a key.
_NUMBER = re.compile(r"(?<![\w.])[+-]?[\d_]+\.[\d_]+([eE][+-]?[\d_]+)?(?=[ \t\r]*([,\]}#]|$))")


def read(path: Path, kind: str = "scene file") -> dict[str, Any]:
    """The tables of a file in TOML. **Raises:** `InputError` for one that cannot be read, and as `tables`."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); allowed: a {kind} in TOML") from None
    except ValueError:
        raise InputError(f"is no name of a file; allowed: a {kind} in TOML") from None
    return tables(data, kind)


def tables(data: bytes, kind: str = "scene file") -> dict[str, Any]:
    """The tables that TOML describes.

    **Raises:** `InputError` for what is no TOML, for integers beyond 64 bits, and for more than a scene needs of what would
    take over 20 times its room in memory.
    """
    if len(data) > LARGEST:
        raise InputError(f"has {len(data)} bytes or more; allowed: a {kind} of at most {LARGEST} bytes")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"has a byte at {error.start} that is not UTF-8; allowed: a {kind} in TOML"
        ) from None
    # What begins as a remark may be the end of a text in lines of its own.
    texts_in_lines = '"""' in text or "'''" in text
    _check_room(text if texts_in_lines else _REMARK.sub("", text))
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of more digits than Python reads
        raise InputError(
            f"is not TOML: {str(error) or 'nested too deep'}; allowed: a {kind} in TOML"
        ) from None
    _check_integers(table, "")
    return table


def _check_room(text: str) -> None:
    """Refuse text that tomllib would need far more room for: each part of a dotted key is a table, twice, and to read one of
    a million parts takes all the memory there is; of each table and list that has a key of its own it keeps notes."""
    everywhere = 0
    for number, line in enumerate(text.split("\n"), 1):
        if "." not in line:
            continue
        dots = _NUMBER.sub("", line).count(".")
        everywhere += dots
        if dots > _DOTS:
            raise InputError(f"line {number} has {dots} dots outside of numbers; allowed: {_DOTS} or fewer")
    headers = sum(1 for _ in _HEADER.finditer(text))
    found = (everywhere, headers + text.count("{"), text.count("="), text.count("["))
    for count, (what, most) in zip(found, _MOST.items(), strict=True):
        if count > most:
            raise InputError(f"has {count} {what}; allowed: {most} or fewer")


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
