"""The figures of docs/concepts.md, each drawn from what the library answers; the documentation's build calls this."""

import io
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import hapjax

MU, STIFFNESS = 0.6, 800.0


def god_object() -> Figure:
    """A finger goes down into a surface and along it; where the god-object is meanwhile."""
    t = np.linspace(0, 1, 401)
    path = np.stack(
        [4e-3 * np.clip(t - 0.3, 0, None) / 0.7, 0 * t, 1e-3 - 3.5e-3 * np.minimum(t / 0.4, 1)], axis=-1
    )
    force = _force(hapjax.Surface(STIFFNESS, mu=MU), path)
    god = path + force / STIFFNESS  # without damping the force is k (g - h)
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    place = figure.subplots()
    place.axhspan(-4, 0, color="0.9")
    place.plot(1e3 * path[:, 0], 1e3 * path[:, 2], color="C0", label="h, the finger")
    for i in (130, 240, 400):
        (x, _, z), (gx, _, gz) = 1e3 * path[i], 1e3 * god[i]
        radius = MU * max(-z, 0.0)
        place.plot(
            [x - radius, x + radius], [0, 0], color="C2", linewidth=4, alpha=0.5, solid_capstyle="butt"
        )
        place.plot([x, gx], [z, gz], color="0.5", linewidth=1)
        place.plot(x, z, "o", color="C0")
        place.plot(gx, gz, "s", color="C3")
    place.plot([], [], "s", color="C3", label="g, the god-object")
    place.plot([], [], color="C2", linewidth=4, alpha=0.5, label="friction circle, radius mu d")
    place.set(xlabel="x / mm", ylabel="z / mm", xlim=(-2, 6), ylim=(-3, 1.4), aspect="equal")
    place.legend(loc="upper right", fontsize="small")
    return figure


def stick_and_slip() -> Figure:
    """The tangential force of a stroke to and fro, within the friction cone."""
    t = np.linspace(0, 1, 1001)
    path = np.stack([4e-3 * np.sin(4 * np.pi * t), 0 * t, -1.5e-3 - 1e-3 * t], axis=-1)
    force = _force(hapjax.Surface(STIFFNESS, mu=MU), path)
    along, limit = force[:, 0], MU * force[:, 2]
    slips = np.abs(along) >= limit * (1 - 1e-5)
    figure = Figure(figsize=(7, 2.8), layout="constrained")
    place = figure.subplots()
    place.fill_between(t, -limit, limit, color="C2", alpha=0.2, label="within mu times the normal force")
    place.plot(t, along, color="C0", label="tangential force, sticks")
    place.plot(t, np.where(slips, along, np.nan), color="C3", linewidth=2.5, label="slips")
    place.set(xlabel="time / s", ylabel="force / N")
    figure.legend(loc="outside upper center", fontsize="small", ncols=3)  # within it covers a slip
    return figure


def gravity_drop() -> Figure:
    """Two fingers hold a cube beside its middle, softly, harder, and hard enough."""
    t = 1e-3 * np.arange(1000)
    figure = Figure(figsize=(7, 2.8), layout="constrained")
    place = figure.subplots()
    for part in (0.3, 0.8, 1.2):
        angle = _swing(part, len(t))
        place.plot(t, np.degrees(angle), label=f"A = {part} A_crit")
    place.set(xlabel="time / s", ylabel="turned about the grip / degrees")
    place.legend(fontsize="small")
    return figure


def _force(surface: hapjax.Surface, path: np.ndarray) -> np.ndarray:
    """The forces (T, 3) N on a finger that goes along a path (T, 3) m over a plane."""
    scene = hapjax.Scene({"plane": hapjax.Object(hapjax.Plane(), surface)})
    hips = jnp.asarray(path, scene.integrator.dt.dtype)[:, None]
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    return np.asarray(reply.force[:, 0], float)


def _swing(part: float, steps: int) -> np.ndarray:
    """How far (rad) a cube turns whose friction circles have this part of A_crit; (steps,)."""
    half, depth = 0.03, 4e-3
    surface = hapjax.Surface(STIFFNESS, mu=MU, damping=1.0)
    cube = hapjax.Object(hapjax.Box((2 * half,) * 3), surface, hapjax.Body(0.15))
    scene = hapjax.Scene(
        {"cube": cube},
        torsion=hapjax.GravityDrop(np.pi * (MU * depth) ** 2 / part, twist_damping=5e-4),
        world=hapjax.World(gravity=(0.0, 0.0, -9.81)),
    )
    hip = jnp.asarray([[side * (half - depth), 0.012, 0.0] for side in (-1, 1)], scene.integrator.dt.dtype)
    hips = jnp.broadcast_to(hip, (steps, 2, 3))
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hip), hips)
    pose = np.asarray(jax.device_get(reply.pose[:, 0]), float)
    return np.unwrap(2 * np.arctan2(pose[:, 4], pose[:, 3]), period=2 * np.pi)


FIGURES: dict[str, Callable[[], Figure]] = {
    "god_object": god_object,
    "stick_and_slip": stick_and_slip,
    "gravity_drop": gravity_drop,
}


def svg(figure: Figure) -> bytes:
    """A figure as the bytes of an SVG file."""
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()
