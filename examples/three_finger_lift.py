"""Three fingers close on a box, lift it off the floor, and put it down again: MHS 3.1 and 4.

python examples/three_finger_lift.py [--out DIR]
"""

import numpy as np
from plotting import G, begin, play, save, smoothly

import hapjax

MASS, EDGE, DT, STEPS = 0.2, 0.06, 1e-3, 6000


def scene() -> hapjax.Scene:
    """A box on a floor."""
    box = hapjax.Object(
        hapjax.Box((EDGE,) * 3),
        hapjax.Surface(800.0, mu=0.8, damping=1.0),
        hapjax.Body(MASS),
        position=(0, 0, EDGE / 2),
    )
    return hapjax.Scene(
        {"box": box, "floor": hapjax.Object(hapjax.Plane())},
        {"on_floor": hapjax.Contact(5000.0, mu=0.5, damping=0.5, between=("box", "floor"))},
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )


def path() -> np.ndarray:
    """The fingers (T, 3, 3) m: close, rise by 10 cm, sink again, open."""
    places = np.array([[1.0, 0.4, 0.0], [1.0, -0.4, 0.0], [-1.0, 0.0, 0.0]]) * EDGE / 2
    inward = np.array(
        [[-1.0, 0, 0], [-1.0, 0, 0], [2.0, 0, 0]]
    )  # the finger that is alone presses twice as far
    closed = smoothly(0, 0.1, STEPS) - smoothly(0.9, 1, STEPS)
    risen = smoothly(0.15, 0.4, STEPS) - smoothly(0.6, 0.85, STEPS)
    start = places - 1e-3 * inward + np.array([0, 0, EDGE / 2])
    return start + 5e-3 * closed * inward + 0.1 * risen * np.array([0, 0, 1.0])


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("Three fingers lift a box and put it down again.")
    reply = play(scene(), path())
    time, height, weight = DT * np.arange(STEPS), reply.pose[:, 0, 2], -reply.force[..., 2].sum(axis=1)
    top = STEPS // 2
    print(f"highest: {height.max() * 1e3:.1f} mm; put down at {height[-1] * 1e3:.2f} mm")
    print(f"carried at the top: {weight[top]:.4f} N of {MASS * G:.4f} N")
    print(f"tilt at the top: {np.degrees(2 * np.arccos(reply.pose[top, 0, 3])):.2f} deg")
    save(
        out / "three_finger_lift.png",
        "time / s",
        ("height / mm", {"box": (time, 1e3 * height)}),
        ("force / N", {"carried by the fingers": (time, weight), "weight": (time, 0 * time + MASS * G)}),
    )


if __name__ == "__main__":
    main()
