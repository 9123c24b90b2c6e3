"""Multi-point haptic contact with friction: touch, hold, turn and identify virtual objects."""

from .errors import InputError as InputError
