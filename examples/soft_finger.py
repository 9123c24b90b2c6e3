"""Soft fingertips hold a box beside its centre of mass, up to the limit of their friction in twist.

python examples/soft_finger.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save, turn_about

import hapjax

MASS, EDGE, DEPTH, STIFFNESS, DT, STEPS = 0.1, 0.06, 4e-3, 800.0, 1e-3, 3000
OFFSET = 5e-3
FINGERS = np.array([[EDGE / 2 - DEPTH, -OFFSET, 0.0], [DEPTH - EDGE / 2, -OFFSET, 0.0]])
NEEDED = MASS * G * OFFSET / (2 * STIFFNESS * DEPTH)  # m: the weight's moment over both normal forces


def turned(torsional_mu: float) -> np.ndarray:
    """The turn (T,) rad of the box about the fingers' line."""
    box = hapjax.Object(
        hapjax.Box((EDGE,) * 3), hapjax.Surface(STIFFNESS, mu=0.9, damping=1.0), hapjax.Body(MASS)
    )
    scene = hapjax.Scene(
        {"box": box},
        torsion=hapjax.SoftFinger(torsional_mu, stiffness=0.1, twist_damping=5e-4),
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    return turn_about(0, play(scene, at_rest(FINGERS, STEPS)).pose[:, 0])


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("Soft fingertips hold a box beside its centre of mass.")
    time, curves = DT * np.arange(STEPS), {}
    print(f"needed: {NEEDED * 1e3:.3f} mm of torsional mu")
    for part in (2.0, 1.3, 0.8, 0.3):
        angle = turned(part * NEEDED)
        curves[f"{part:g} of what is needed"] = (time, np.degrees(angle))
        moved = np.degrees(np.ptp(angle[-500:]))
        print(
            f"{part:.1f} of it: turned by {np.degrees(angle[-1]):8.2f} deg, {moved:.4f} deg of it in the last 0.5 s"
        )
    save(out / "soft_finger.png", "time / s", ("turn about the line / deg", curves))


if __name__ == "__main__":
    main()
