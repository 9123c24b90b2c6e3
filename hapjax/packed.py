"""The step for a servo loop: compiled ahead of time, one array in and one out.

A call costs a fixed amount for each array that crosses from Python to the compiled code; a state of twenty of them
costs more than the step itself.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .scene import Scene, dtype_of
from .simulate import State, init, step


@dataclass(frozen=True)
class PackedStep:
    """A compiled step of one scene for a fixed number of fingers.

    `call(memory, hip)` takes the memory of the last call and the fingers' positions (F, 3) in m as a NumPy array of
    `dtype`, and returns the new memory: one array that begins with the forces on the fingers. Under a torsion that reads
    gimbals it is `call(memory, hip, gimbal)`, with their angles (F,) in rad. `start` is the memory before the first
    call. `compile_s` is what compiling took, in s.
    """

    call: Callable[..., Array]
    start: Array
    fingers: int
    dtype: np.dtype
    unravel: Callable[[Array], State]
    compile_s: float

    def force(self, memory: Array) -> np.ndarray:
        """The forces (F, 3) in N on the fingers, world frame, that a call ended with."""
        return np.asarray(memory)[: 3 * self.fingers].reshape(self.fingers, 3)

    def is_lost(self, memory: Array) -> bool:
        """Whether the call left the range of sense: `Reply.lost`."""
        return bool(np.asarray(memory)[-1])

    def state(self, memory: Array) -> State:
        """The memory as a State."""
        return self.unravel(memory[3 * self.fingers : -1])


def pack(
    scene: Scene, hip: Float[Any, "F 3"], dt: float | None = None, gimbal: Float[Any, "F"] | None = None
) -> PackedStep:
    """Compile the step of `scene` for fingers that start at `hip` (F, 3) m; `dt` in s, `None`: the integrator's.

    **Arguments:** `gimbal` (F,) rad, where the scene's torsion is a `Gimbal`.

    **Raises:** `InputError` as `init` does.
    """
    state = init(scene, hip, gimbal)
    flat, unravel = ravel_pytree(state)
    fingers = np.shape(hip)[0]
    dtype = dtype_of(scene)

    def packed(memory: Array, hip: Array, gimbal: Array | None = None) -> Array:
        after, reply = step(scene, unravel(memory[3 * fingers : -1]), hip, dt, gimbal)
        lost = reply.lost.astype(dtype)[None]
        return jnp.concatenate([reply.force.ravel(), ravel_pytree(after)[0], lost])

    start = jnp.concatenate([jnp.zeros(3 * fingers, dtype), flat, jnp.zeros(1, dtype)])
    began = time.perf_counter()
    shapes = [(fingers, 3)] if gimbal is None else [(fingers, 3), (fingers,)]
    call = jax.jit(packed).lower(start, *(jax.ShapeDtypeStruct(shape, dtype) for shape in shapes)).compile()
    return PackedStep(call, start, fingers, np.dtype(dtype), unravel, time.perf_counter() - began)
