"""Which options of the command `hapjax benchmark` apply to which measurement."""

from collections.abc import Mapping
from typing import Any

from ..errors import InputError

_ALWAYS, _WITH, _WITHOUT = "", "with --scene", "without --scene"
_APPLY = {
    "fingers": {
        **dict.fromkeys(("latency", "scene", "gradient", "batch"), _ALWAYS),
        **dict.fromkeys(("stability", "error"), _WITH),
    },
    "seconds": {"latency": _ALWAYS},
    "integrators": {"stability": _ALWAYS, "error": _ALWAYS},
    "maps": {"stability": _WITHOUT},
    "rate": {"stability": _WITH, "error": _WITH},
    "quick": {"stability": _ALWAYS, "error": _WITHOUT, "fit": _ALWAYS},
    "cases": {"error": _WITHOUT},
    "hip": {"error": _WITH, "stability": _WITH},
    "error": {"error": _WITH, "stability": _WITH},
    "out": {"stability": _ALWAYS, "error": _ALWAYS, "fit": _ALWAYS},
}


def check_options(kind: str, has_scene: bool, given: Mapping[str, Any]) -> None:
    """Refuse what would be left unread. **Raises:** `InputError`.

    **Arguments:** `given`, the options that are not at their defaults.
    """
    for name, value in given.items():
        kinds = _APPLY.get(name)
        if kinds is None:
            continue
        said = f"{name} is {' '.join(map(str, value)) if isinstance(value, tuple) else value}"
        if kind not in kinds:
            raise InputError(f"{said} with {kind}; allowed: with {' or '.join(kinds)}")
        if kinds[kind] not in (_ALWAYS, _WITH if has_scene else _WITHOUT):
            raise InputError(f"{said} {'with' if has_scene else 'without'} a scene; allowed: {kinds[kind]}")
