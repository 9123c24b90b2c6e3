"""What one look at the machine says."""

from typing import Any, Literal, NamedTuple


class Check(NamedTuple):
    """One thing that was looked at: its `name`, whether it is as the loop wants it, a `sentence` that says how it is, what
    to do about it (`advice`, empty where nothing), and its `figures`.
    """

    name: str
    state: Literal["good", "poor", "unknown"]
    sentence: str
    advice: str = ""
    figures: dict[str, Any] = {}
