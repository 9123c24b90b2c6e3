"""One finger lifts a basket by its handle, and the basket comes to rest hanging: MHS 3.3.

python examples/handle_lift.py [--out DIR]
"""

import jax
import jax.numpy as jnp
import numpy as np
from plotting import G, begin, save, smoothly

import hapjax
from hapjax import rotation

MASS, RADIUS, HANGS, DT, STEPS = 0.3, 0.01, 0.08, 1e-3, 5000
FOLLOW = 4.0  # 1/s: the hand moves towards the centre of mass, which ends a swing that nothing else does


def scene() -> hapjax.Scene:
    """A bar along y that can be touched, and a mass that hangs below it; the bar stands a little above the finger."""
    body = hapjax.Body(MASS, inertia=(4e-4, 3e-4, 4e-4), centre=(HANGS, 0, 0))
    bar = hapjax.Object(
        hapjax.Capsule(
            RADIUS, 0.1
        ),  # along z of its own frame, which is turned to y; its x points down, and tilted
        hapjax.Surface(1500.0, mu=0.8, damping=4.0),
        body,
        position=(0.0, 0.0, RADIUS + 1e-3),
        orientation=tilted(0.3),
    )
    return hapjax.Scene(
        {"basket": bar}, world=hapjax.World(gravity=(0, 0, -G)), integrator=hapjax.SemiImplicit(dt=DT)
    )


def tilted(angle: float) -> jax.Array:
    """x of the bar's frame to -z of the world, z to y, y to -x; then turned by `angle` rad about the bar."""
    return rotation.product(
        jnp.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0]), jnp.array([0.5, -0.5, 0.5, 0.5])
    )


def lift(follow: float = FOLLOW) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The fingertip and the basket's centre of mass, (T, 3) m, and the force (T, 3) N."""
    basket = scene()
    hip = jnp.zeros(3)
    rise = 0.15 * smoothly(0.05, 0.5, STEPS)[:, 0, 0]

    def one(carry, height):
        state, hip = carry
        motion = state.motion["basket"]
        centre = motion.position + HANGS * rotation.to_matrix(motion.orientation)[:, 0]
        hip = jnp.append(hip[:2] + DT * follow * (centre - hip)[:2], height)
        state, reply = hapjax.step(basket, state, hip[None])
        return (state, hip), (hip, centre, reply.force[0])

    start = (hapjax.init(basket, hip[None]), hip)
    return jax.tree.map(np.asarray, jax.jit(lambda s: jax.lax.scan(one, s, jnp.asarray(rise))[1])(start))


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("One finger lifts a basket by its handle.")
    hip, centre, force = lift()
    time = DT * np.arange(STEPS)
    beside = 1e3 * (centre - hip)[:, :2]
    print(
        f"at rest: centre {np.hypot(*beside[-1]):.2f} mm beside the finger, {1e3 * (hip - centre)[-1, 2]:.1f} mm below"
    )
    print(f"swing in the last second: {np.ptp(beside[-1000:], axis=0).max():.3f} mm")
    print(f"carried: {-force[-1, 2]:.4f} N of {MASS * G:.4f} N")
    save(
        out / "handle_lift.png",
        "time / s",
        ("height / mm", {"finger": (time, 1e3 * hip[:, 2]), "centre of mass": (time, 1e3 * centre[:, 2])}),
        (
            "centre beside the finger / mm",
            {"across the bar": (time, beside[:, 0]), "along it": (time, beside[:, 1])},
        ),
    )


if __name__ == "__main__":
    main()
