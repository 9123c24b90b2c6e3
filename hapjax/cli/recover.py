"""`hapjax recover`."""

import sys
from pathlib import Path

from tyro.conf import Positional

from ..files import check_apart, check_writable, write_json
from ..progress import following


def recover(recording: Positional[Path], *, out: Path | None = None, json: Path | None = None) -> None:
    """Make a whole file of a recording (.mcap) that was cut short or is damaged, and say what is lost.

    The recording stays as it is. Example: hapjax recover lift.mcap --out whole.mcap

    Args:
        recording: MCAP file, of any recorder.
        out: File to write, which must not exist; absent: the recording's name with -recovered.
        json: File for what was found; - is standard output.
    """
    from ..recording.recovering import recover as recovering

    target = recording.parent / f"{recording.stem}-recovered.mcap" if out is None else out
    check_apart([json], [recording, target])
    if json is not None:
        check_writable(json)
    with following(1.0, doing="recovering") as advance:
        found = recovering(recording, target, advance)
    for sentence in found.lost:
        print(f"hapjax: {recording}: lost: {sentence}", file=sys.stderr)
    each = ", ".join(f"{topic} {count}" for topic, count in sorted(found.messages.items())) or "none"
    whole = "; the file was whole" if found.whole else ""
    print(f"{target}: {found.messages.total()} messages ({each}){whole}")
    if json is not None:
        messages = dict(sorted(found.messages.items()))
        write_json(
            json, {"file": str(target), "messages": messages, "lost": found.lost, "whole": found.whole}
        )
