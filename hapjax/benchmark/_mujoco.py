"""MuJoCo's side of a work-precision diagram: the same case, in its own loop in C."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ..extras import need
from ._sweep import LONG, REPEATS, Point, Sweep, difference, mean_square, neighbours
from .cases import Case, Mujoco

INTEGRATORS = {"Euler": "mjINT_EULER", "implicitfast": "mjINT_IMPLICITFAST", "RK4": "mjINT_RK4"}
NOSLIP = "noslip"  # Euler, and then MuJoCo's pass that takes the slip out of what holds
NOSLIP_ITERATIONS = 10


def variants(case: Case) -> list[str]:
    """MuJoCo's integrators, and `noslip` where a case is about holding."""
    holds = isinstance(case.mujoco, Mujoco) and case.mujoco.holds
    return [*INTEGRATORS, NOSLIP] if holds else [*INTEGRATORS]


class Model:
    """A case's model with one integrator."""

    def __init__(self, case: Case, spec: Mujoco, integrator: str):
        self.case, self.spec, self.mujoco = case, spec, need("mujoco", "bench")
        self.model = self.mujoco.MjModel.from_xml_string(spec.xml)
        if integrator == NOSLIP:
            self.model.opt.noslip_iterations = NOSLIP_ITERATIONS
        rule = INTEGRATORS["Euler" if integrator == NOSLIP else integrator]
        self.model.opt.integrator = getattr(self.mujoco.mjtIntegrator, rule)
        # A run that has blown up is to be seen, and not started again.
        self.model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = self.mujoco.MjData(self.model)
        self._gravity = self.model.opt.gravity.copy()
        # Else each blow-up is printed, and written to a file in the working folder.
        self.mujoco.set_mju_user_warning(lambda message: None)

    def run(self, steps: int, repeats: int = REPEATS) -> tuple[np.ndarray, float]:
        """What is compared, NaN where MuJoCo warns of a blow-up, and the least s of a run."""
        best = np.inf
        for _ in range(repeats):
            self._reset(steps)
            drive = self._ready(steps)
            began = time.perf_counter()
            drive()
            best = min(best, time.perf_counter() - began)
            if best > LONG:
                break
        if any(warning.number for warning in self._warnings()):
            return np.array(np.nan), best
        self.mujoco.mj_forward(self.model, self.data)
        return np.asarray(self.spec.read(self.model, self.data), float), best

    def _warnings(self) -> list[Any]:
        kinds = self.mujoco.mjtWarning
        return [
            self.data.warning[k] for k in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        ]

    def _reset(self, steps: int) -> None:
        self.model.opt.timestep = self.case.seconds / steps
        self.model.opt.gravity[:] = self._gravity
        self.mujoco.mj_resetData(self.model, self.data)
        self.spec.start(self.model, self.data)

    def _ready(self, steps: int):
        """The whole run as one call, whose loop is in C."""
        if self.spec.path is not None:
            return self._along(self.spec.path, steps)
        step, change = partial(self.mujoco.mj_step, self.model, self.data), self.spec.change
        if change is None:
            return partial(step, nstep=steps)

        def halves():
            step(nstep=steps // 2)
            change(self.model)
            step(nstep=steps - steps // 2)

        return halves

    def _along(self, path, steps: int):
        """A run in which mocap bodies go along a path, by MuJoCo's rollout."""
        rollout = need("mujoco.rollout", "bench").rollout
        kinds = self.mujoco.mjtState
        full, dt = kinds.mjSTATE_FULLPHYSICS, self.case.seconds / steps
        start = np.empty(self.mujoco.mj_stateSize(self.model, full))
        self.mujoco.mj_getState(self.model, self.data, start, full)
        places = np.ascontiguousarray(path(dt * (np.arange(steps) + 0.5)))[None]
        states = np.empty((1, steps, len(start)))
        sensors = np.empty((1, steps, self.model.nsensordata))

        def drive():
            rollout(
                self.model,
                self.data,
                start[None],
                places,
                control_spec=int(kinds.mjSTATE_MOCAP_POS),
                nstep=steps,
                state=states,
                sensordata=sensors,
            )
            self.mujoco.mj_setState(self.model, self.data, states[0, -1], full)

        return drive


def curve(case: Case, integrator: str, counts: Sequence[int], law: np.ndarray, sweep: Sweep) -> list[Point]:
    """The points of one integrator, coarsest first, up to the sweep's most steps."""
    assert isinstance(case.mujoco, Mujoco)
    model, points = Model(case, case.mujoco, integrator), []
    for steps in counts:
        if steps > sweep.longest("MuJoCo"):
            break
        _, taken = model.run(steps)
        values = [model.run(n, 1)[0] for n in neighbours(steps, sweep.around)]
        error = mean_square([difference(value, law) for value in values])
        points.append(Point(case.seconds / steps, taken / case.seconds, None, error))
    return points
