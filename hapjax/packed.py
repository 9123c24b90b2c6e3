"""The step for a servo loop: compiled ahead of time, one array in and one out.

A call costs a fixed amount for each array that crosses from Python to the compiled code; a state of twenty of them
costs more than the step itself.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._flat_step import FlatStep, Traced, flat_step, handed
from .errors import InputError
from .god_object import Touch
from .paths import number_at, part_at
from .scene import Scene, dtype_of
from .simulate import State, init, known, step_known


@dataclass(frozen=True)
class PackedStep:
    """A compiled step of one scene for a fixed number of fingers.

    `call(memory, hip)` takes the memory of the last call and the fingers' positions (F, 3) in m as a NumPy array of
    `dtype`, and returns the new memory: one array that begins with the forces on the fingers. Under a torsion that reads
    gimbals it is `call(memory, hip, gimbal)`, with their angles (F,) in rad. `start` is the memory before the first
    call, and `begin(hip)` or `begin(hip, gimbal)` that for fingers which begin elsewhere. `compile_s` is what compiling
    took, in s. `live`: where in the memory the live numbers of each path are; other values put there are those of all
    calls from then on.
    """

    call: partial[Array]
    begin: Callable[..., np.ndarray]
    start: Array
    fingers: int
    dtype: np.dtype
    compile_s: float
    live: dict[str, slice]
    flat: FlatStep

    def force(self, memory: Array) -> np.ndarray:
        """The forces (F, 3) in N on the fingers, world frame, that a call ended with."""
        return np.asarray(memory)[: 3 * self.fingers].reshape(self.fingers, 3)

    def is_lost(self, memory: Array) -> bool:
        """Whether the call left the range of sense: `Reply.lost`."""
        return bool(np.asarray(memory)[self.flat.first - 1])

    def state(self, memory: Array) -> State:
        """The memory as a State."""
        return self.flat.state(memory)

    def touches(self, memory: Array) -> dict[str, Touch]:
        """What each finger did on each touchable object in the call: `Reply.touch`."""
        return self.flat.reply(memory).touch


def pack(
    scene: Scene,
    hip: Float[Any, "F 3"],
    dt: float | None = None,
    gimbal: Float[Any, "F"] | None = None,
    live: Sequence[str] = (),
) -> PackedStep:
    """Compile the step of `scene` for fingers that start at `hip` (F, 3) m; `dt` in s, `None`: the integrator's.

    The same `hip`s give the same forces as through `rollout`, to the last bit, on the same machine and with the same
    `XLA_FLAGS`.

    **Arguments:** `gimbal` (F,) rad, where the scene's torsion is a `Gimbal`. `live`: paths of numbers, such as
    `object.cube.surface.mu`, that can be changed between two calls.

    **Raises:** `InputError` as `init` does, and for paths of no numbers.
    """
    state = init(scene, hip, gimbal)
    fingers, dtype, numbers = np.shape(hip)[0], dtype_of(scene), _live(scene, live)
    inputs = [jax.ShapeDtypeStruct(shape, dtype) for shape in [(fingers, 3), (fingers,)]]
    period = None if dt is None else jnp.asarray(dt, dtype)
    began = time.perf_counter()
    known_now = jax.jit(known)(scene)
    arguments = known_now, state, inputs[0], period, None if gimbal is None else inputs[1]
    parts = flat_step(Traced(step_known, *arguments), *arguments)
    before = parts.before(state)
    last = len(before)
    ends = [last, *(last + np.cumsum([number.size for number in numbers.values()], dtype=int)).tolist()]
    places = {path: slice(*ends[i : i + 2]) for i, path in enumerate(numbers)}
    # Never compiled in: with numbers that it knows, the compiler rounds otherwise than in `rollout`, which does not.
    arrays, whole = handed((scene if live else known_now, period))

    def packed(arrays: Any, memory: Array, hip: Array, gimbal: Array | None = None) -> Array:
        if not live:
            return parts.call(arrays, memory, hip, gimbal)
        given, period = whole(*arrays)
        values = [memory[place].reshape(numbers[path].shape) for path, place in places.items()]
        now = known(eqx.tree_at(lambda s: [part_at(s, path) for path in live], given, values))
        after = parts.call(handed((now, period))[0], memory[:last], hip, gimbal)
        return jnp.concatenate([after, memory[last:]])

    held = [number.ravel() for number in numbers.values()]
    start = jnp.concatenate([before, *held])

    def begin(hip: Float[Any, "F 3"], gimbal: Float[Any, "F"] | None = None) -> np.ndarray:
        memory = np.array(start)
        memory[:last] = parts.before(init(scene, hip, gimbal))
        return memory

    inputs = inputs[: 1 if gimbal is None else 2]
    call = partial(jax.jit(packed).lower(arrays, start, *inputs).compile(), arrays)
    compile_s = time.perf_counter() - began
    return PackedStep(call, begin, start, fingers, np.dtype(dtype), compile_s, places, parts)


def _live(scene: Scene, paths: Sequence[str]) -> dict[str, Array]:
    """The numbers that are to be live, by their paths."""
    numbers = {path: number_at(scene, path) for path in paths}
    if len(numbers) < len(paths):
        raise InputError(f"live is {', '.join(paths)}; allowed: each path once")
    return numbers
