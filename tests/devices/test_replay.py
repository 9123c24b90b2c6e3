"""A recording made by the loop replays through rollout bit for bit, though they are two programs."""

import json
import os
import subprocess
import sys

import pytest

import replay_cases


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "fingers"), [("float32", 3), ("float64", 1)])
def test_a_recording_replays_to_the_last_bit(precision, fingers, tmp_path):
    """In a process of its own: as the suite compiles, in haste, nothing is rounded together in any program."""
    command = [sys.executable, replay_cases.__file__, precision, str(fingers), str(tmp_path / "lift.mcap")]
    as_a_user = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    done = subprocess.run(command, env=as_a_user, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["ticks"] == replay_cases.TICKS and figures["most"] > 1.5
    assert len(figures["since"]) == (fingers == 1) and all(
        0 < tick < figures["ticks"] for tick in figures["since"]
    )
    assert (figures["result"], figures["file"]) == (0, 0)
