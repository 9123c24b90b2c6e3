"""A servo loop recorded and replayed, compiled as a user has it: python replay_cases.py DTYPE FINGERS FILE.mcap.

One finger's friction and wall change in the middle of it. Prints as JSON how many ticks there were, from which on numbers
were others, what the fingers felt most (N), and at how many ticks a replay differs: of the result's own recording, and of
the recorder's file.
"""

import json
import os
import sys
import threading
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from mcap.reader import make_reader

import hapjax
import hapjax_devices as devices
from hapjax.paths import with_numbers
from hapjax.scene_file import scene_from_dict
from hapjax_devices import demo

TICKS = 2000
CHANGED = {"object.cube.surface.mu": 0.5, "object.cube.surface.stiffness": 900.0}


def scene_in(file: Path) -> hapjax.Scene:
    """The scene that a recorder's file has with it, of the type that it says."""
    with open(file, "rb") as opened:
        reader = make_reader(opened)
        (run,) = reader.iter_metadata()
        (text,) = [a.data for a in reader.iter_attachments() if a.name == "scene.toml"]
    return hapjax.cast(scene_from_dict(tomllib.loads(text.decode()), None), run.metadata["dtype"])


def changed(name: str, since: list[int]) -> None:
    """Change numbers of a run in the middle of it; adds the tick from which on they count."""
    with devices.TickReader(name, 120.0) as reader, devices.Numbers(name) as numbers:
        while reader.last < TICKS // 4:
            time.sleep(0.02)
            reader.take()
        since.append(numbers.set(CHANGED))


def differing(scene: hapjax.Scene, recording: hapjax.Recording, dtype: str, since: list[int]) -> int:
    """At how many ticks a rollout answers something else."""
    assert recording.hip is not None and recording.model_force is not None
    hips = jnp.asarray(recording.hip, dtype)
    state, forces = hapjax.init(scene, hips[0]), []
    for part in np.split(hips, since):
        state, replies = hapjax.rollout(scene, state, part, 1e-3)
        forces.append(np.asarray(replies.force, np.float64))
        scene = with_numbers(scene, CHANGED)
    return int(np.sum(np.any(np.concatenate(forces) != recording.model_force, axis=(1, 2))))


def main(dtype: str, fingers: str, file: str) -> None:
    """Record the demonstration's lift, replay both recordings, and say how it went."""
    jax.config.update("jax_enable_x64", True)
    task, name = demo.three_finger_lift(0), f"replay-{os.getpid()}"
    scene = task.scene if fingers == "3" else replace(task.scene, torsion=hapjax.SoftFinger(0.004, 1.0))
    scene, held = hapjax.cast(scene, dtype), task.devices[: int(fingers)]
    recorder = devices.RecorderProcess(name, Path(file), patience=120.0)
    since: list[int] = []
    live = tuple(CHANGED) if fingers == "1" else ()
    changing = threading.Thread(target=changed, args=(name, since))
    bus = devices.Broadcast(name, readers=3 if live else 1, patience=60.0)
    if live:
        changing.start()
    result = devices.run(scene, held, 1e-3 * TICKS, broadcast=bus, overrun=5, live=live)
    if live:
        changing.join()
    code, said = recorder.wait(60.0)
    assert code == 0, said
    written = hapjax.Recording.load(file)
    assert written.model_force is not None
    figures = {
        "ticks": len(written.model_force),
        "since": since,
        "most": float(np.abs(written.model_force).max()),
        "result": differing(scene, result.recording, dtype, since),
        "file": differing(scene_in(Path(file)), written, dtype, since),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main(*sys.argv[1:])
