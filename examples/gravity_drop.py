"""Two fingers hold a box beside its centre of mass; how it drops depends on how firmly: MHS 3.2, solution 2.

python examples/gravity_drop.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save, turn_about

import hapjax

MASS, EDGE, DEPTH, MU, DT, STEPS = 0.1, 0.06, 4e-3, 0.9, 1e-3, 5000
AREA = np.pi * (MU * DEPTH) ** 2
FINGERS = np.array([[EDGE / 2 - DEPTH, -0.02, 0.0], [DEPTH - EDGE / 2, -0.02, 0.0]])


def drop(share: float, twist_damping: float | None = 1e-3) -> np.ndarray:
    """The poses (T, 7) of a box under fingers whose A is `share` times A_crit; 0: no torsion."""
    box = hapjax.Object(hapjax.Box((EDGE,) * 3), hapjax.Surface(800.0, mu=MU, damping=1.0), hapjax.Body(MASS))
    torsion = hapjax.GravityDrop(AREA / share, twist_damping) if share else None
    scene = hapjax.Scene(
        {"box": box},
        torsion=torsion,
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    return np.asarray(play(scene, at_rest(FINGERS, STEPS)).pose[:, 0])


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("Two fingers hold a box beside its centre of mass.")
    time, turned = DT * np.arange(STEPS), {}
    for share in (0.0, 0.2, 0.8, 1.5):
        pose = drop(share)
        turned[f"A = {share:g} A_crit" if share else "no torsion"] = (time, np.degrees(turn_about(0, pose)))
        beside, below = 1e3 * (pose[-1, 1:3] - FINGERS[0, 1:])
        print(
            f"A = {share:3.1f} A_crit: centre ends {beside:6.2f} mm beside the line, {-below:6.2f} mm below it"
        )
    save(out / "gravity_drop.png", "time / s", ("turn about the line / deg", turned))


if __name__ == "__main__":
    main()
