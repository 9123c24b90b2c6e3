"""A rod held at one end by two fingers, let go and then swung: its centre follows an arc about them (MHS 3.3 and 6).

python examples/rod_swing.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save

import hapjax

MASS, LENGTH, WIDTH, DT, STEPS = 0.05, 0.3, 0.02, 1e-3, 3000
GRASP = np.array([-0.14, 0.0, 0.0])  # m, beside the rod's centre
DEPTH = 3e-3
RADIUS = float(np.linalg.norm(GRASP))


def swing(method=hapjax.SemiImplicit, shaken: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The middle of the fingers and the rod's centre, both (T, 3) m; the hand goes to and fro by `shaken` m."""
    rod = hapjax.Object(
        hapjax.Box((LENGTH, WIDTH, WIDTH)), hapjax.Surface(3000.0, mu=1.0, damping=1.0), hapjax.Body(MASS)
    )
    scene = hapjax.Scene({"rod": rod}, world=hapjax.World(gravity=(0, 0, -G)), integrator=method(dt=DT))
    side = np.array([0.0, WIDTH / 2 - DEPTH, 0.0])
    hips = np.array(at_rest(np.stack([GRASP + side, GRASP - side]), STEPS))
    hips[..., 0] += shaken * np.sin(2 * np.pi * 1.2 * DT * np.arange(STEPS))[:, None]
    return hips.mean(axis=1), np.asarray(play(scene, hips).pose[:, 0, :3])


def off_the_arc(hand: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """How far (T,) m the centre is off the circle about the fingers."""
    return np.linalg.norm(centre - hand, axis=1) - RADIUS


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A rod is held at one end and swung.")
    arcs, errors, time = {}, {}, DT * np.arange(STEPS)
    for name, method, shaken in (
        ("let go", hapjax.SemiImplicit, 0.0),
        ("let go, pivot form", hapjax.PivotForm, 0.0),
        ("swung by the hand", hapjax.SemiImplicit, 0.02),
    ):
        hand, centre = swing(method, shaken)
        relative, error = centre - hand, off_the_arc(hand, centre)
        arcs[name] = (1e3 * relative[:, 0], 1e3 * relative[:, 2])
        errors[name] = (time, 1e3 * error)
        swept = np.degrees(np.ptp(np.unwrap(np.arctan2(relative[:, 2], relative[:, 0]))))
        print(
            f"{name}: swept {swept:.0f} deg, at most {1e3 * np.abs(error).max():.2f} mm off the arc of {1e3 * RADIUS:.0f} mm"
        )
    save(
        out / "rod_swing.png",
        "time / s",
        ("z / mm", arcs, "x / mm"),
        ("off the arc / mm", errors),
    )


if __name__ == "__main__":
    main()
