"""A pole on one fingertip: it stays up while the finger moves under its centre, and falls when it does not (MHS 3.3).

python examples/pole_balance.py [--out DIR]
"""

import jax
import jax.numpy as jnp
import numpy as np
from plotting import G, begin, save

import hapjax

MASS, LENGTH, DT, STEPS = 0.1, 0.5, 1e-3, 4000
HALF = LENGTH / 2
# e, how far the centre leans over the finger, obeys e'' = A e - B a under the finger's acceleration a (a thin rod).
A, B, RATE = 0.75 * G / HALF, 0.75, 4.0  # RATE: rad/s, of the four poles of the closed loop
PLACE, SPEED = RATE**4 / A, 4 * RATE**3 / A
LEAN, LEANING = (6 * RATE**2 + A + PLACE) / B, (4 * RATE + SPEED) / B


def scene() -> hapjax.Scene:
    """A pole that leans by 2 degrees, its foot at the origin."""
    half, tilt = HALF, np.radians(2.0)
    pole = hapjax.Object(
        hapjax.Box((0.02, 0.02, LENGTH)),
        hapjax.Surface(2000.0, mu=1.0, damping=2.0),
        hapjax.Body(MASS),
        position=(half * np.sin(tilt), 0, half * np.cos(tilt)),
        orientation=(np.cos(tilt / 2), 0, np.sin(tilt / 2), 0),
    )
    return hapjax.Scene(
        {"pole": pole}, world=hapjax.World(gravity=(0, 0, -G)), integrator=hapjax.SemiImplicit(dt=DT)
    )


def balance(control: float) -> tuple[np.ndarray, np.ndarray]:
    """The centre of the pole and the fingertip, both (T, 3) m; `control` 1 or 0: with or without the feedback."""
    pole = scene()
    hip = jnp.array([0.0, 0.0, MASS * G / 2000.0])

    def one(carry, _):
        state, hip, speed = carry
        motion = state.motion["pole"]
        lean, leaning = (motion.position - hip)[:2], motion.velocity[:2] - speed
        speed = speed + control * DT * (LEAN * lean + LEANING * leaning + PLACE * hip[:2] + SPEED * speed)
        hip = hip.at[:2].add(DT * speed)
        state, _ = hapjax.step(pole, state, hip[None])
        return (state, hip, speed), (state.motion["pole"].position, hip)

    start = (hapjax.init(pole, hip[None]), hip, jnp.zeros(2))
    centre, finger = jax.jit(lambda s: jax.lax.scan(one, s, None, STEPS)[1])(start)
    return np.asarray(centre), np.asarray(finger)


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A pole is balanced on one fingertip.")
    time, heights, places = DT * np.arange(STEPS), {}, {}
    for name, control in (("balanced", 1.0), ("finger at rest", 0.0)):
        centre, finger = balance(control)
        heights[name] = (time, centre[:, 2])
        places[f"lean, {name}"] = (time, 1e3 * (centre - finger)[:, 0].clip(-HALF, HALF))
        lean = np.hypot(*(centre - finger)[-1, :2]) * 1e3
        print(
            f"{name}: after {STEPS * DT:g} s the centre is at {centre[-1, 2]:.3f} m, {lean:.3g} mm beside the finger"
        )
        if control:
            places["finger"] = (time, 1e3 * finger[:, 0])
    heights["finger at rest"] = (time, heights["finger at rest"][1].clip(-HALF))  # it falls on for ever
    save(out / "pole_balance.png", "time / s", ("height of the centre / m", heights), ("place / mm", places))


if __name__ == "__main__":
    main()
