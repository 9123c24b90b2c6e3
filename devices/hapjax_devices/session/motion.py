"""What virtual fingers do in a session: a recorded motion, or a virtual operator's, there and back without end."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hapjax import InputError, Scene, rotation
from hapjax.benchmark.error_scene import operator
from hapjax.errors import within
from hapjax.recording import Recording, load_recording

from ..operator import Hand, waypoints
from ..virtual import VirtualDevice

FOLLOWING = Hand(mass=0.15, stiffness=1e6)  # goes where the motion says, whatever pushes it
ABOVE, SPREAD = 1.0, 0.015  # m, from where a surface is looked for, and between fingers beside each other
PRESS, STROKE, GAP = 1.0, 0.02, 0.01  # N, m, m


def recorded(file: Path, fingers: int | None) -> Recording:
    """The recording whose fingers are followed; `fingers`, how many there are to be, `None`: as many as it has.

    **Raises:** `InputError` where it cannot be read, has no motion, or one of another number of fingers.
    """
    recording = load_recording(file)
    with within(f"{file}: "):
        if recording.hip is None or recording.hip_t is None or len(recording.hip_t) < 2:
            raise InputError("hip has fewer than two samples; allowed: the recorded motion of the fingers")
        if fingers is not None and recording.fingers != fingers:
            raise InputError(f"hip has {recording.fingers} fingers; allowed: {fingers}, one for each device")
    return recording


def virtual_finger(
    scene: Scene, finger: int, fingers: int, rate: float, recording: Recording | None
) -> VirtualDevice:
    """The device of one of the fingers, at its own rate (Hz)."""
    gimbal = None
    if recording is None:
        path = _operator(scene, fingers, rate)[:, finger]
    else:
        path = np.asarray(recording.hip_every(1 / rate)[:, finger])
        if recording.gimbal is not None and recording.hip_t is not None:
            times = recording.hip_t[0] + np.arange(len(path)) / rate
            gimbal = _there_and_back(recording.gimbal_at(times)[:, finger])
    return VirtualDevice(_there_and_back(path), 1 / rate, FOLLOWING, gimbal=gimbal, again=True)


def _there_and_back(path: Float[np.ndarray, "T ..."]) -> Float[np.ndarray, "N ..."]:
    """A path whose end meets its beginning, without a jump."""
    return np.concatenate([path, path[-2:0:-1]])


def _operator(scene: Scene, fingers: int, rate: float) -> Float[np.ndarray, "T F 3"]:
    """Grip and lift the first object that moves and is felt; where none does, stroke the first that is felt."""
    if any(scene.object[name].body is not None for name in scene.touchable()):
        return operator(scene, fingers, rate)
    return _strokes(scene, fingers, rate)


def _strokes(scene: Scene, fingers: int, rate: float) -> Float[np.ndarray, "T F 3"]:
    """Press on the first object that is felt, from the side that its own z axis points to, and rub along its x axis."""
    if not scene.touchable():
        raise InputError("no object of the scene has a surface; allowed: one that fingers feel")
    thing = scene.object[scene.touchable()[0]]
    assert thing.surface is not None
    turn = np.asarray(rotation.to_matrix(rotation.normalise(thing.orientation)))
    t = np.arange(round(2 * rate) + 1) / rate
    depth = waypoints([0.0, 0.5], [-GAP, PRESS / float(thing.surface.stiffness)], t)
    along = waypoints([0.5, 1.25, 2.0], [0.0, STROKE / 2, -STROKE / 2], t)
    across = SPREAD * (np.arange(fingers) - (fingers - 1) / 2)
    start = jnp.asarray([[0.0, y, ABOVE] for y in across], thing.position.dtype)
    # A path point that has gone over an edge presses on air: that is a motion too.
    near = jax.vmap(thing.shape.closest)(start)
    normal = np.asarray(near.normal)
    spots = np.asarray(start) + np.asarray(near.depth)[:, None] * normal
    local = spots[None] - depth[:, None, None] * normal + along[:, None, None] * np.eye(3)[0]
    return local @ turn.T + np.asarray(thing.position)
