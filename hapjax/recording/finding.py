"""Finding: something about a recording that its user should know, in words."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What was noticed about a channel of a recording, with the evidence, and what was done about it.

    **Attributes:** `channel`, of the recording; `kind`, a few words that stay the same from case to case, such as
    `"dropout"` or `"force sign"`; `sentence`, the evidence with its numbers; `done`, what was done about it; `at`, the time
    in s where it is or begins, `None` where it is everywhere; `count`, of how many samples or places; `recording`, its name
    where there are several.
    """

    channel: str
    kind: str
    sentence: str
    done: str = "only reported"
    at: float | None = None
    count: int = 1
    recording: str = ""

    def __str__(self) -> str:
        place = f"{self.recording}: " if self.recording else ""
        return f"{place}{self.kind}: {self.sentence} ({self.done})"
