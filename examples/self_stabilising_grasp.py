"""A box in three fingers is struck, and comes to static equilibrium by itself: MHS 3.1.

python examples/self_stabilising_grasp.py [--out DIR]
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from plotting import G, at_rest, begin, play, save

import hapjax

MASS, EDGE, DT, STEPS = 0.1, 0.06, 1e-3, 6000
FINGERS = np.array([[0.0285, 0.012, 0.0], [0.0285, -0.012, 0.0], [-0.027, 0.0, 0.001]])


def struck() -> hapjax.Reply:
    """Every reply after the blow."""
    box = hapjax.Object(
        hapjax.Box((EDGE,) * 3), hapjax.Surface(800.0, mu=0.9, damping=1.0), hapjax.Body(MASS)
    )
    world = hapjax.World(gravity=(0, 0, -G), gyroscopic=True)
    scene = hapjax.Scene({"box": box}, world=world, integrator=hapjax.SemiImplicit(dt=DT))
    state = hapjax.init(scene, FINGERS)
    blow = [jnp.array([0.02, -0.03, 0.02]), jnp.array([1.0, -0.7, 1.5])]  # m/s, rad/s
    state = eqx.tree_at(lambda s: [s.motion["box"].velocity, s.motion["box"].spin], state, blow)
    return play(scene, at_rest(FINGERS, STEPS), state=state)


def residual(reply) -> tuple[np.ndarray, np.ndarray]:
    """The whole force (T,) N and torque (T,) N m on the box, its weight included."""
    before = np.concatenate([np.zeros((1, 3)), reply.pose[:-1, 0, :3]])
    force = -reply.force.sum(axis=1) - np.array([0, 0, MASS * G])
    torque = np.cross(FINGERS - before[:, None], -reply.force).sum(axis=1)
    return np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1)


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A box in three fingers is struck and comes to rest.")
    reply = struck()
    time, (force, torque) = DT * np.arange(STEPS), residual(reply)
    print(f"after {STEPS * DT:g} s: residual force {force[-1]:.1e} N, torque {torque[-1]:.1e} N m")
    print(f"moved in the last second: {np.ptp(reply.pose[-1000:, 0, :3], axis=0).max():.1e} m")
    save(
        out / "self_stabilising_grasp.png",
        "time / s",
        (
            "log10 of the residual",
            {"force / N": (time, np.log10(force)), "torque / (N m)": (time, np.log10(torque))},
        ),
        ("place / mm", {a: (time, 1e3 * reply.pose[:, 0, i]) for i, a in enumerate("xyz")}),
    )


if __name__ == "__main__":
    main()
