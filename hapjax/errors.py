"""The one exception of hapjax that a user's input can cause."""


class InputError(ValueError):
    """Bad input. The message is one sentence: the file, field or channel, the value, and the allowed range."""
