"""The pushed block as `mujoco.sysid` identifies it: its model, its residuals, its search, its intervals."""

import contextlib
import io
from types import ModuleType

import numpy as np
from jaxtyping import Float

from hapjax import InputError, Recording
from hapjax.extras import need

from .pushed import DT, HALF, MASS, MU, NOISE, STIFFNESS, G

# Of time constants of contact from 1e-5 to 0.02 s, damping ratios from 1 to 4, both cones and ratios of impedance from 1 to
# 100 this is nearest the law, at this time step; MuJoCo's own 0.02 s is 30 times as far off.
_MODEL = f"""<mujoco><option timestep="{DT}" gravity="0 0 -{G}" cone="elliptic" impratio="10"/><worldbody>
<geom type="plane" size="9 9 1"/><body pos="0 0 {HALF}"><joint name="x" type="slide" axis="1 0 0"/>
<joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/><geom name="block" type="box"
size="{HALF} {HALF} {HALF}" mass="{MASS}" priority="1" friction="{MU} 0.005 0.0001" solref="0.003 1"/></body></worldbody>
<actuator><position name="finger" joint="x" kp="{STIFFNESS}"/></actuator>
<sensor><actuatorfrc name="force" actuator="finger"/></sensor></mujoco>"""
_SETTLE = 2000  # steps in which the block sinks in under its weight
_BOUNDS = 20.0  # times the truth, up and down


def programs() -> tuple[ModuleType, ModuleType]:
    """MuJoCo and its identification. **Raises:** `InputError` where they, or what they need, are missing."""
    mujoco, sysid = need("mujoco", "bench"), need("mujoco.sysid", "bench")
    if not hasattr(sysid, "optimize"):  # it hides what it misses
        raise InputError(
            "what mujoco.sysid needs is not installed; allowed with it: pip install 'hapjax[bench]'"
        )
    return mujoco, sysid


def fit(
    recording: Recording, start: tuple[float, float]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """mu and mass (kg), and the half widths of their 95 % intervals, by its search as it is when nothing is asked of it."""
    mujoco, sysid = programs()
    spec = mujoco.MjSpec.from_string(_MODEL)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=_SETTLE)
    rest = sysid.create_initial_state(model, np.array([0, 0, data.qpos[2]]), np.zeros(3))
    assert recording.hip is not None and recording.hip_t is not None
    assert recording.force is not None and recording.force_t is not None
    assert recording.pose is not None and recording.pose_t is not None
    place, force, path = recording.pose[:, 0, 0], -recording.force[:, 0, 0], recording.hip[:, 0, :1] + HALF
    series = sysid.TimeSeries
    control = series(recording.hip_t, path, series.compute_all_control_mapping(model))
    seen = series.from_names(recording.force_t, force[:, None], model)
    run = sysid.ModelSequences("block", spec, "pushed", rest, control, seen)
    place_t, force_t = recording.pose_t, recording.force_t

    def compared(params, told, measured, model, whole, state, **_):
        # States are those after a step, forces those at its beginning.
        x = np.interp(place_t, np.append(0, state[:, 0]), np.append(0, state[:, 1]))
        f = np.interp(force_t, told.times - DT, told.data[:, 0])
        off = [(x - place) / NOISE["position"], (f - force) / NOISE["force"]]
        return np.concatenate(off)[:, None], told, measured

    residuals = sysid.build_residual_fn(models_sequences=[run], modify_residual=compared)
    params = sysid.ParameterDict()
    for name, truth, first, put in (
        ("mu", MU, start[0], lambda spec, p: spec.geom("block").friction.__setitem__(0, p.value[0])),
        ("mass", MASS, start[1], lambda spec, p: setattr(spec.geom("block"), "mass", p.value[0])),
    ):
        params.add(sysid.Parameter(name, first, truth / _BOUNDS, truth * _BOUNDS, modifier=put))
    with contextlib.redirect_stdout(io.StringIO()):
        found, end = sysid.optimize(initial_params=params, residual_fn=residuals, verbose=False)
        at_end, _, _ = residuals(found.as_vector(), found)
    with np.errstate(all="ignore"):
        _, widths = sysid.calculate_intervals(at_end, np.asarray(end.jac))
    return found.as_vector(), np.asarray(widths)
