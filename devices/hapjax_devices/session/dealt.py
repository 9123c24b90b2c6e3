"""Which of several devices of a kind each finger is on, where nobody says."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hapjax import InputError

from .. import falcon, inverse3
from ..device import DeviceError


class _Kind(NamedTuple):
    """What devices of a kind are called, one and several; the key of a table that says which is meant; and what they are
    called that are attached, `None` for one that has no name: some are found by a URL."""

    one: str
    several: str
    key: str
    attached: Callable[[str], Sequence[str | None]]


_KINDS = {
    "falcon": _Kind(
        "Falcon", "Falcons", "serial", lambda _: [each.serial for each in falcon.attached_falcons()]
    ),
    "inverse3": _Kind("Inverse3", "Inverse3", "device_id", inverse3.attached_inverse3),
}


def dealt(tables: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], str]:
    """The tables of a session's devices, those that do not say which they mean with the names that are left, in their order.

    Only where a kind is asked for twice or more and as often as it is attached: where there are more, the driver asks which
    is meant. Also a sentence that says which finger is on what, empty where none was dealt.

    **Raises:** `InputError` where fewer are attached than are asked for, but not none: the driver tells of that.
    """
    groups: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    for place, table in enumerate(tables):
        if table["type"] in _KINDS:
            groups[table["type"], table.get("url", inverse3.URL)].append(place)
    names = {}
    for (kind, url), places in groups.items():
        names |= _names(_KINDS[kind], url, tables, places)
    found = [
        table if place not in names else table | {_KINDS[table["type"]].key: names[place]}
        for place, table in enumerate(tables)
    ]
    said = [f"finger {place} is on the {_KINDS[found[place]['type']].one} {names[place]}" for place in names]
    return found, ", ".join(said)


def _names(kind: _Kind, url: str, tables: list[dict[str, Any]], places: list[int]) -> dict[int, str]:
    """The name of each of these places of tables that has none, where they can be dealt out."""
    without = [place for place in places if kind.key not in tables[place]]
    if not without or len(places) < 2:
        return {}
    try:
        attached = kind.attached(url)
    except DeviceError:
        return {}  # as the driver will say
    names = sorted({name for name in attached if name is not None})
    if 0 < len(attached) < len(places):
        raise InputError(
            f"device has {len(places)} {kind.several}, but attached "
            f"{'is' if len(attached) == 1 else 'are'} {len(attached)}; allowed: {', '.join(names) or 'no more'}"
        )
    if len(attached) != len(places) or len(names) < len(attached):
        return {}
    taken = {tables[place].get(kind.key) for place in places}
    left = (name for name in names if name not in taken)
    return dict(zip(without, left, strict=False))
