"""Two fingers turn a box by their instrumented gimbals: MHS 3.2, solution 1.

python examples/gimbal.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save, turn_about

import hapjax

MASS, EDGE, DEPTH, MU, DT, STEPS = 0.1, 0.06, 4e-3, 0.9, 1e-3, 3000
AREA = np.pi * (MU * DEPTH) ** 2
FINGERS = np.array(
    [[DEPTH - EDGE / 2, -0.01, 0.0], [EDGE / 2 - DEPTH, -0.01, 0.0]]
)  # their line goes along +x
TIME = DT * np.arange(STEPS)
GIMBALS = np.stack([1.0 * np.sin(2 * np.pi * TIME / 3) ** 2, 0.6 * np.sin(2 * np.pi * TIME / 3) ** 2], axis=1)


def turned(share: float) -> np.ndarray:
    """The turn (T,) rad of a box about the line of fingers whose A is `share` times A_crit."""
    box = hapjax.Object(hapjax.Box((EDGE,) * 3), hapjax.Surface(800.0, mu=MU, damping=1.0), hapjax.Body(MASS))
    scene = hapjax.Scene(
        {"box": box},
        torsion=hapjax.Gimbal(AREA / share, twist_damping=1e-3),
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    return turn_about(0, play(scene, at_rest(FINGERS, STEPS), GIMBALS).pose[:, 0])


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("Two fingers turn a box by their gimbals.")
    mean = GIMBALS.mean(axis=1)
    curves = {"mean of the gimbals": (TIME, np.degrees(mean))}
    for share in (2.0, 0.5):
        angle = turned(share)
        curves[f"box, A = {share:g} A_crit"] = (TIME, np.degrees(angle))
        print(f"A = {share:g} A_crit: largest difference to the gimbals {np.abs(angle - mean).max():.4f} rad")
    save(out / "gimbal.png", "time / s", ("turn about the line / deg", curves))


if __name__ == "__main__":
    main()
