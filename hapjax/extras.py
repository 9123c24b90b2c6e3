"""The parts of hapjax that need more than the core's libraries, loaded when they are used."""

from importlib import import_module
from types import ModuleType

from .errors import InputError


def need(module: str, extra: str) -> ModuleType:
    """Import `module`. **Raises:** `InputError` that names the extra to install, where a library is missing."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(
            f"{error.name} is not installed; allowed with it: pip install 'hapjax[{extra}]'"
        ) from None
