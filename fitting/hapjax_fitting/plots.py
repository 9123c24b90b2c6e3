"""The plots of a report, by section."""

from collections.abc import Mapping

from .canvas import Image
from .plots_of_fit import of_fit
from .plots_of_recording import of_recording
from .replay import replay
from .result import FitResult

_MOST_RECORDINGS = 12  # as many as a page of some 3 MB holds


def figures(result: FitResult, truth: Mapping[str, float] | None) -> dict[str, list[Image]]:
    """All plots as (PNG in base64, caption), by the heading of their section."""
    found = {"The fit": of_fit(result, truth)}
    pairs = list(zip(result.recordings, result.names, strict=True))
    for i, (recording, name) in enumerate(pairs[:_MOST_RECORDINGS]):
        found[f"Recording {i + 1}: {name}"] = of_recording(result, replay(result, recording, name))
    if len(pairs) > _MOST_RECORDINGS:
        found[f"The fit used all {len(pairs)} recordings; the first {_MOST_RECORDINGS} are plotted"] = []
    return found
