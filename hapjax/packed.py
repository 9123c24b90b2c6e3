"""The step for a servo loop: compiled ahead of time, one array in and one out.

A call costs a fixed amount for each array that crosses from Python to the compiled code; a state of twenty of them
costs more than the step itself.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .errors import InputError
from .paths import number_at, part_at
from .scene import Scene, dtype_of
from .simulate import State, init, step


@dataclass(frozen=True)
class PackedStep:
    """A compiled step of one scene for a fixed number of fingers.

    `call(memory, hip)` takes the memory of the last call and the fingers' positions (F, 3) in m as a NumPy array of
    `dtype`, and returns the new memory: one array that begins with the forces on the fingers. Under a torsion that reads
    gimbals it is `call(memory, hip, gimbal)`, with their angles (F,) in rad. `start` is the memory before the first
    call. `compile_s` is what compiling took, in s. `live`: where in the memory the live numbers of each path are; other
    values put there are those of all calls from then on.
    """

    call: Callable[..., Array]
    start: Array
    fingers: int
    dtype: np.dtype
    unravel: Callable[[Array], State]
    compile_s: float
    live: dict[str, slice]

    def force(self, memory: Array) -> np.ndarray:
        """The forces (F, 3) in N on the fingers, world frame, that a call ended with."""
        return np.asarray(memory)[: 3 * self.fingers].reshape(self.fingers, 3)

    def is_lost(self, memory: Array) -> bool:
        """Whether the call left the range of sense: `Reply.lost`."""
        return bool(np.asarray(memory)[-1])

    def state(self, memory: Array) -> State:
        """The memory as a State."""
        return self.unravel(memory[3 * self.fingers : min((s.start for s in self.live.values()), default=-1)])


def pack(
    scene: Scene,
    hip: Float[Any, "F 3"],
    dt: float | None = None,
    gimbal: Float[Any, "F"] | None = None,
    live: Sequence[str] = (),
) -> PackedStep:
    """Compile the step of `scene` for fingers that start at `hip` (F, 3) m; `dt` in s, `None`: the integrator's.

    **Arguments:** `gimbal` (F,) rad, where the scene's torsion is a `Gimbal`. `live`: paths of numbers, such as
    `object.cube.surface.mu`, that can be changed between two calls; the others are compiled in.

    **Raises:** `InputError` as `init` does, and for paths of no numbers.
    """
    state = init(scene, hip, gimbal)
    flat, unravel = ravel_pytree(state)
    fingers = np.shape(hip)[0]
    dtype = dtype_of(scene)
    first = 3 * fingers + len(flat)
    numbers = _live(scene, live)
    ends = [first, *(first + np.cumsum([number.size for number in numbers.values()], dtype=int)).tolist()]
    places = {path: slice(*ends[i : i + 2]) for i, path in enumerate(numbers)}

    def now(memory: Array) -> Scene:
        """The scene with the numbers that the memory has."""
        if not live:
            return scene
        values = [memory[place].reshape(numbers[path].shape) for path, place in places.items()]
        return eqx.tree_at(lambda s: [part_at(s, path) for path in live], scene, values)

    def packed(memory: Array, hip: Array, gimbal: Array | None = None) -> Array:
        after, reply = step(now(memory), unravel(memory[3 * fingers : first]), hip, dt, gimbal)
        lost = reply.lost.astype(dtype)[None]
        kept = [memory[first:-1]] if live else []
        return jnp.concatenate([reply.force.ravel(), ravel_pytree(after)[0], *kept, lost])

    held = [number.ravel() for number in numbers.values()]
    start = jnp.concatenate([jnp.zeros(3 * fingers, dtype), flat, *held, jnp.zeros(1, dtype)])
    began = time.perf_counter()
    shapes = [(fingers, 3)] if gimbal is None else [(fingers, 3), (fingers,)]
    call = jax.jit(packed).lower(start, *(jax.ShapeDtypeStruct(shape, dtype) for shape in shapes)).compile()
    return PackedStep(call, start, fingers, np.dtype(dtype), unravel, time.perf_counter() - began, places)


def _live(scene: Scene, paths: Sequence[str]) -> dict[str, Array]:
    """The numbers that are to be live, by their paths."""
    numbers = {path: number_at(scene, path) for path in paths}
    if len(numbers) < len(paths):
        raise InputError(f"live is {', '.join(paths)}; allowed: each path once")
    return numbers
