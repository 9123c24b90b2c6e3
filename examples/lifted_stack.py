"""A stack of three cubes is put in motion by its lowest one alone: two fingers lift it, and carry the weight of all (MHS 6).

python examples/lifted_stack.py [--out DIR]
"""

import jax.numpy as jnp
import numpy as np
from plotting import G, begin, save

import hapjax

MASS, EDGE, COUNT = 0.05, 0.04, 3


def stack() -> hapjax.Scene:
    """Cubes on each other on a floor. Fingers feel the lowest, and hold it in twist: about the line between two points a
    stack is a pendulum upside down."""
    objects = {
        f"cube{i}": hapjax.Object(
            hapjax.Box((EDGE,) * 3),
            hapjax.Surface(1000.0, mu=1.0, damping=1.0) if i == 0 else None,
            hapjax.Body(MASS),
            (0, 0, EDGE * (i + 0.5)),
        )
        for i in range(COUNT)
    }
    below = ["floor", *objects]
    contacts = {
        f"{name}_on_{under}": hapjax.Contact(2e3, mu=0.6, damping=2.0, between=(name, under))
        for name, under in zip(objects, below, strict=False)
    }
    return hapjax.Scene(
        objects | {"floor": hapjax.Object(hapjax.Plane())},
        contacts,
        hapjax.GravityDrop(1e-7),
        hapjax.World((0, 0, -G)),
        hapjax.SemiImplicit(),
    )


def lift(seconds=4.0) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """The fingers' pull (T,) N, the heights (T, O) m, and what each contact carries (T,) N."""
    scene, t = stack(), np.arange(0, seconds, 1e-3)
    apart = EDGE / 2 + 1e-3 - 4e-3 * np.clip(t / 0.5, 0, 1)
    height = EDGE / 2 + 0.03 * np.clip(t - 1, 0, 1)
    hips = np.stack([np.stack([x, 1e-3 + 0 * t, height], axis=-1) for x in (apart, -apart)], axis=1)
    _, replies = hapjax.rollout(scene, hapjax.init(scene, hips[0]), jnp.asarray(hips))
    carried = {name: np.asarray(touch.normal_force).sum(axis=1) for name, touch in replies.contact.items()}
    return -np.asarray(replies.force)[..., 2].sum(axis=1), np.asarray(replies.pose)[..., 2], carried


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("Two fingers lift the lowest of three cubes.")
    pull, heights, carried = lift()
    time = 1e-3 * np.arange(len(pull))
    weight = MASS * G
    print(f"pull at the end: {pull[-1]:.4f} N, three cubes weigh {COUNT * weight:.4f} N")
    for name, force in carried.items():
        print(f"{name.replace('_', ' ')}: {force[-1] / weight:.3f} cubes' weight")
    pulls = {"two fingers": (time, pull)} | {n.replace("_", " "): (time, f) for n, f in carried.items()}
    rises = {f"cube{i}": (time, 1e3 * z) for i, z in enumerate(heights.T)}
    save(out / "lifted_stack.png", "time / s", ("force / N", pulls), ("height / mm", rises))


if __name__ == "__main__":
    main()
