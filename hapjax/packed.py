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
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .errors import InputError
from .god_object import Touch
from .paths import number_at, part_at
from .scene import Scene, dtype_of
from .simulate import State, init, known, step, step_known

_SMALL = 64  # numbers: an array of more is handed over by itself


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

    call: Callable[..., Array]
    begin: Callable[..., np.ndarray]
    start: Array
    fingers: int
    dtype: np.dtype
    unravel: Callable[[Array], State]
    compile_s: float
    live: dict[str, slice]
    rest: Callable[[Array], tuple[Array, dict[str, Touch], dict[str, Touch]]]

    def force(self, memory: Array) -> np.ndarray:
        """The forces (F, 3) in N on the fingers, world frame, that a call ended with."""
        return np.asarray(memory)[: 3 * self.fingers].reshape(self.fingers, 3)

    def is_lost(self, memory: Array) -> bool:
        """Whether the call left the range of sense: `Reply.lost`."""
        return bool(np.asarray(memory)[-1])

    def state(self, memory: Array) -> State:
        """The memory as a State."""
        return self.unravel(memory)

    def touches(self, memory: Array) -> dict[str, Touch]:
        """What each finger did on each touchable object in the call: `Reply.touch`."""
        return self.rest(memory)[1]


def pack(
    scene: Scene,
    hip: Float[Any, "F 3"],
    dt: float | None = None,
    gimbal: Float[Any, "F"] | None = None,
    live: Sequence[str] = (),
) -> PackedStep:
    """Compile the step of `scene` for fingers that start at `hip` (F, 3) m; `dt` in s, `None`: the integrator's.

    The same `hip`s give the same forces as through `rollout`, to the last bit, on the same machine.

    **Arguments:** `gimbal` (F,) rad, where the scene's torsion is a `Gimbal`. `live`: paths of numbers, such as
    `object.cube.surface.mu`, that can be changed between two calls.

    **Raises:** `InputError` as `init` does, and for paths of no numbers.
    """
    state = init(scene, hip, gimbal)
    flat, build = ravel_pytree(state)
    fingers = np.shape(hip)[0]
    dtype = dtype_of(scene)
    first = 3 * fingers + len(flat)
    numbers = _live(scene, live)
    ends = [first, *(first + np.cumsum([number.size for number in numbers.values()], dtype=int)).tolist()]
    places = {path: slice(*ends[i : i + 2]) for i, path in enumerate(numbers)}

    # Never compiled in: with numbers that it knows, the compiler rounds otherwise than in `rollout`, which does not.
    given = scene if live else jax.jit(known)(scene)
    arrays, whole = _handed((given, None if dt is None else jnp.asarray(dt, dtype)))

    def packed(arrays: Any, memory: Array, hip: Array, gimbal: Array | None = None) -> Array:
        given, period = whole(*arrays)
        if live:
            values = [memory[place].reshape(numbers[path].shape) for path, place in places.items()]
            given = known(eqx.tree_at(lambda s: [part_at(s, path) for path in live], given, values))
        after, reply = step_known(given, unravel(memory), hip, period, gimbal)
        kept = [memory[first : ends[-1]]] if live else []
        # Touches of contacts have no reader, but what the compiler leaves out changes how it rounds what is left.
        rest = ravel_pytree((reply.pose, reply.touch, reply.contact))[0].astype(dtype)
        lost = reply.lost.astype(dtype)[None]
        return jnp.concatenate([reply.force.ravel(), ravel_pytree(after)[0], *kept, rest, lost])

    def unravel(memory: Array) -> State:
        return build(memory[3 * fingers : first])

    _, answer = jax.eval_shape(step, scene, state, np.zeros((fingers, 3), dtype), dt, gimbal)
    answered = jax.tree.map(lambda x: jnp.zeros(x.shape, dtype), (answer.pose, answer.touch, answer.contact))
    blank, as_answered = ravel_pytree(answered)
    held = [number.ravel() for number in numbers.values()]
    start = jnp.concatenate([jnp.zeros(3 * fingers, dtype), flat, *held, blank, jnp.zeros(1, dtype)])

    def rest(memory: Array) -> tuple[Array, dict[str, Touch], dict[str, Touch]]:
        return as_answered(memory[ends[-1] : -1])

    def begin(hip: Float[Any, "F 3"], gimbal: Float[Any, "F"] | None = None) -> np.ndarray:
        memory = np.array(start)
        memory[3 * fingers : first] = np.concatenate(
            [np.ravel(leaf) for leaf in jax.tree.leaves(init(scene, hip, gimbal))]
        )
        return memory

    began = time.perf_counter()
    shapes = [(fingers, 3)] if gimbal is None else [(fingers, 3), (fingers,)]
    inputs = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
    call = partial(jax.jit(packed).lower(arrays, start, *inputs).compile(), arrays)
    compile_s = time.perf_counter() - began
    return PackedStep(call, begin, start, fingers, np.dtype(dtype), unravel, compile_s, places, rest)


def _handed(tree: Any) -> tuple[tuple[Array, list[Array]], Callable[..., Any]]:
    """A pytree as few arrays, its small ones all in one, and what makes it of them again."""
    leaves, structure = jax.tree.flatten(tree)
    small = [leaf.size <= _SMALL for leaf in leaves]
    vector, apart = ravel_pytree([leaf for leaf, few in zip(leaves, small, strict=True) if few])
    large = [leaf for leaf, few in zip(leaves, small, strict=True) if not few]

    def whole(vector: Array, large: list[Array]) -> Any:
        parts, others = iter(apart(vector)), iter(large)
        return jax.tree.unflatten(structure, [next(parts if few else others) for few in small])

    return (vector, large), whole


def _live(scene: Scene, paths: Sequence[str]) -> dict[str, Array]:
    """The numbers that are to be live, by their paths."""
    numbers = {path: number_at(scene, path) for path in paths}
    if len(numbers) < len(paths):
        raise InputError(f"live is {', '.join(paths)}; allowed: each path once")
    return numbers
