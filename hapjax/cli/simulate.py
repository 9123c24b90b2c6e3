"""`hapjax simulate`."""

import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tyro.conf import Positional

from ..errors import within
from ..files import check_apart
from ..progress import following
from ..recording import Recording, load_recording
from ..recording.ros_topics import parsed
from ..scene import Scene
from ..scene_file import load_scene
from ..simulate import init, rollout

_PIECE = 1000  # steps from one word of how far it is to the next


def simulate(scene: Positional[Path], *, hip: Path, out: Path, topic: tuple[str, ...] = ()) -> None:
    """Replay a path of fingertips through a scene, and write the forces (N) and poses (m) it answers with.

    Example: hapjax simulate cube.toml --hip lift.npz --out answer.csv

    Args:
        scene: Scene file (TOML).
        hip: Recording (.npz, .csv, .mcap, .parquet) whose channel hip (m, world frame) is replayed at the scene's time
            step, and, where the scene's torsion is a gimbal, its channel gimbal (rad).
        out: Recording to write (.npz, .csv, .mcap, .parquet): hip, force on the fingers, pose of the moving objects.
        topic: Of a ROS 2 bag: the topics of hip, one a finger, such as hip=/left/tip,/right/tip.
    """
    topics = parsed(topic)
    check_apart([out], [scene, hip])
    Recording.check_writable(out)
    with jax.enable_x64(True):
        loaded = load_scene(scene)
        dt = float(loaded.integrator.dt)
        with following(None, doing="reading"):
            recording = _loaded(hip, topics)
        with within(f"{hip}: "):
            path = recording.hip_every(dt)
            assert recording.hip_t is not None
            times = recording.hip_t[0] + dt * np.arange(len(path))
            turned = loaded.torsion is not None and loaded.torsion.needs_gimbal
            gimbals = recording.gimbal_at(times) if turned else None
        forces, poses = _answers(loaded, np.asarray(path), gimbals)
    channels: dict[str, Any] = {
        "hip": path,
        "hip_t": times,
        "force": forces,
        "force_t": times,
    }
    if gimbals is not None:
        channels |= {"gimbal": gimbals, "gimbal_t": times}
    if loaded.moving():
        channels |= {"pose": poses, "pose_t": times + dt}  # a step's poses belong to its end
    with within(f"{scene} with {hip}: the simulation ended with "):
        answer = Recording(**channels)
    with following(None, doing="writing"):
        answer.save(out)


def _answers(scene: Scene, path: np.ndarray, gimbals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Forces (N) and poses (m) along a path, piece by piece; pieces of one length, so that one program does them all."""
    length, answers = min(_PIECE, len(path)), []
    state = init(scene, path[0], None if gimbals is None else gimbals[0])
    with following(float(len(path))) as advance:
        for first in range(0, len(path), length):
            steps = np.minimum(np.arange(first, first + length), len(path) - 1)
            turned = None if gimbals is None else gimbals[steps]
            state, reply = rollout(scene, state, path[steps], gimbals=turned)
            kept = min(length, len(path) - first)
            answers.append((np.asarray(reply.force)[:kept], np.asarray(reply.pose)[:kept]))
            advance("simulating", float(kept))
    forces, poses = zip(*answers, strict=True)
    return np.concatenate(forces), np.concatenate(poses)


def _loaded(path: Path, topics) -> Recording:
    """A recording, cleaned; what was found is said on stderr."""
    recording = load_recording(path, topics)
    for finding in recording.findings:
        print(f"hapjax: {path}: {finding}", file=sys.stderr)
    return recording
