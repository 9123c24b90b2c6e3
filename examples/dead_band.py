"""A ball in three fingers at 50 Hz: its rotation oscillates until a dead band on the torque ends that (MHS 5).

python examples/dead_band.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save

import hapjax

MASS, RADIUS, STIFFNESS, PRESS = 0.1, 0.03, 180.0, 6e-3
# Three fingers turn the ball back with 3 k r (r - press) a radian. At 50 Hz the step times the rate is above 2 for that,
# and below it for the ball's place, with 3 k: the rotation is unstable, the place is not.
INERTIA = 0.4 * MASS * RADIUS**2
ROTATION, PLACE = (3 * STIFFNESS * RADIUS * (RADIUS - PRESS) / INERTIA) ** 0.5, (3 * STIFFNESS / MASS) ** 0.5
CRITICAL = 1e-3  # N m


def hold(dt: float, dead_band: float | None, seconds: float = 1.5) -> hapjax.Reply:
    """Every reply of fingers that hold the ball still, one of them 0.3 mm too high."""
    angle = np.array([0, 2, 4]) * np.pi / 3
    fingers = (RADIUS - PRESS) * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    fingers[0, 2] += 3e-4
    ball = hapjax.Object(
        hapjax.Sphere(RADIUS), hapjax.Surface(STIFFNESS, mu=1.0, damping=0.3), hapjax.Body(MASS)
    )
    world = hapjax.World(gravity=(0, 0, -G), dead_band=dead_band)
    scene = hapjax.Scene({"ball": ball}, world=world, integrator=hapjax.SemiImplicit(dt=dt))
    return play(scene, at_rest(fingers, round(seconds / dt)))


def turned(reply: hapjax.Reply) -> np.ndarray:
    """The angle (T,) rad that the ball has turned by."""
    return 2 * np.arccos(np.minimum(np.abs(reply.pose[:, 0, 3]), 1))


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A dead band ends the oscillation of a grasp at 50 Hz.")
    print(
        f"step times rate at 50 Hz, stable below 2: rotation {0.02 * ROTATION:.2f}, place {0.02 * PLACE:.2f}"
    )
    curves = {}
    for name, dt, band in (
        ("50 Hz", 0.02, None),
        (f"50 Hz, T_crit = {CRITICAL * 1e3:g} mN m", 0.02, CRITICAL),
        ("1 kHz", 0.001, None),
    ):
        reply = hold(dt, band)
        angle, half = np.degrees(turned(reply)), len(reply.pose) // 2
        curves[name] = (dt * np.arange(len(angle)), np.log10(np.maximum(angle, 1e-6)))
        moves, height = np.ptp(angle[half:]), 1e3 * reply.pose[-1, 0, 2]
        print(f"{name}: in the last half turns by {moves:.2g} deg, ends at a height of {height:.3g} mm")
    save(out / "dead_band.png", "time / s", ("log10 of the turn / deg, at least -6", curves))


if __name__ == "__main__":
    main()
