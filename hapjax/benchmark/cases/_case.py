"""What a case is: a scene, the fingers' motion, what is compared at the end, and the truth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

from ... import rotation
from ...body import Motion
from ...integrate import METHODS, Integrator
from ...scene import Scene
from ...simulate import State

G = 9.81  # m/s^2

ORDERS = {"semi_implicit": 1, "semi_implicit_matrix": 1, "pivot": 1, "lie_midpoint": 2, "implicit": 1}
"""The order of each integrator where the force is smooth."""


@dataclass(frozen=True)
class Order:
    """The order of convergence that theory gives, and why; `value` `None`: no order can be seen."""

    value: int | None
    reason: str = ""


@dataclass(frozen=True)
class Mujoco:
    """The same case for MuJoCo.

    `xml`: the model, less integrator and time step; `start(model, data)` sets the start, `read(model, data)` gives what
    the case compares; `change(model)` is done at half time; `path(t)` (T, 3 n): where the mocap bodies are;
    `holds`: whether nothing is to slip, for which MuJoCo has an option of its own.
    """

    xml: str
    read: Callable[[Any, Any], Any]
    start: Callable[[Any, Any], None] = lambda model, data: None
    change: Callable[[Any], None] | None = None
    path: Callable[[np.ndarray], np.ndarray] | None = None
    holds: bool = False


@dataclass(frozen=True)
class Gradient:
    """The derivative of what is compared in one leaf of the scene: `where` it is, its `name`, and the `truth`.

    `along`: the direction, of a leaf with several numbers.
    """

    name: str
    where: Callable[[Scene], Any]
    truth: Callable[[], np.ndarray]
    along: Any = 1.0


def _far(t: Any) -> Any:
    """One finger that touches nothing."""
    return jnp.full((1, 3), 9.0, t.dtype)


@dataclass(frozen=True)
class Case:
    """One problem of the work-precision diagrams.

    - `name`, `title`, `unit` (of the error); `seconds`, the final time.
    - `scene(integrator)`, and `start(state)`, which sets velocities; `hip(t)` (F, 3) m, `gimbal(t)` (F,) rad;
      `change(scene)`: the scene after half time.
    - `measure(state)`: the numbers that are compared; an error is the Euclidean norm of a difference.
    - `truth()`: of the equations that hapjax solves, in closed form or from an independent program. `None`: extrapolated.
    - `law()`: of the rigid law that both programs approximate, where it is not the same. MuJoCo is compared by it.
    - `rigid(scene, dt)`: the scene as stiff as dt allows, for the comparison by the law; MuJoCo's contacts are so by
      themselves. `None`: as it is.
    - `known`: where the truth comes from, in words.
    - `orders`: of integrators whose order differs here.
    - `smooth`: no touch begins and no slide ends on the way, so that errors do not depend on where in a step that happens.
    - `lands`: points come down with a speed along the surface, and are held where the first step that finds them does.
    - `gain`: by how much a step's rounding grows by the end: of a fast body, about the angle (rad) that it turns, since what
      its spin is off by goes on turning it.
    - `mujoco`: the model, or why there is none.
    - `ticks`: of a loop whose fingers are known once a tick: into how many the time is cut. Shorter steps are then substeps
      of a tick, and the fingers are fed as a servo loop feeds them, where they are at its end. `None`: any steps, fingers
      fed as suits the integrator best.
    """

    name: str
    title: str
    unit: str
    seconds: float
    scene: Callable[[Integrator], Scene]
    measure: Callable[[State], Any]
    known: str
    mujoco: Mujoco | str
    start: Callable[[State], State] = lambda state: state
    hip: Callable[[Any], Any] = _far
    gimbal: Callable[[Any], Any] | None = None
    change: Callable[[Scene], Scene] | None = None
    truth: Callable[[], np.ndarray] | None = None
    law: Callable[[], np.ndarray] | None = None
    rigid: Callable[[Scene, float], Scene] | None = None
    gradient: Gradient | None = None
    orders: Mapping[str, Order] = field(default_factory=dict)
    smooth: bool = False
    lands: bool = False
    gain: float = 1.0
    ticks: int | None = None

    def order(self, integrator: str) -> Order:
        """The theory's order of an integrator on this case."""
        return self.orders.get(integrator, self.orders.get("*", Order(ORDERS.get(integrator, 1))))

    def gradient_order(self, integrator: str) -> int | None:
        """That of the derivative: the state's where all is smooth, else 1, as it sees where in its step a slide ends or a
        touch begins; none where the state has none."""
        order = self.order(integrator).value
        if self.gradient is None or order is None:
            return None
        return order if self.smooth else 1

    def scatters(self, integrator: str) -> bool:
        """Whether the error of the state depends on chance: on where in a step a touch begins or a slide ends.

        That moves the end by dt^2, next to nothing where the rule's own error goes like dt; by dt where a case `lands`,
        unless an integrator looks ahead. By the rigid law errors scatter always.
        """
        first = ORDERS.get(integrator, 1) == self.order(integrator).value == 1
        late = self.lands and not METHODS[integrator].looks_ahead
        return not self.smooth and (not first or late or self.rigid is not None)


def turned(motion: Motion) -> Any:
    """The orientation as 9 numbers, of which a small difference has the norm of its angle in rad."""
    return rotation.to_matrix(motion.orientation).ravel() / jnp.sqrt(jnp.asarray(2, motion.orientation.dtype))


def turned_mujoco(matrix: np.ndarray) -> np.ndarray:
    """`turned` of MuJoCo's or SciPy's matrix."""
    return np.asarray(matrix, float).ravel() / np.sqrt(2)


EXACT = {"lie_midpoint": Order(None, "the force is constant, and the midpoint rule is exact")}
HOLDS = {"*": Order(None, "at rest at any dt: what holds does not creep")}
