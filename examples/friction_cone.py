"""A block is dragged by a finger pressed onto it: it sticks within the friction cone, and slips (MHS 2).

python examples/friction_cone.py [--out DIR]
"""

import numpy as np
from plotting import G, begin, play, save

import hapjax

MASS, EDGE, DT, STEPS = 0.2, 0.06, 1e-3, 6000
STATIC, KINETIC, STIFFNESS, DEPTH, SPEED = 0.6, 0.3, 200.0, 0.01, 0.01


def drag() -> tuple[np.ndarray, hapjax.Reply]:
    """The finger (T, 1, 3) m, which moves at an even speed, and every reply."""
    top = hapjax.Surface(STIFFNESS, mu=2.0, damping=0.2)
    block = hapjax.Object(
        hapjax.Box((EDGE,) * 3), top, hapjax.Body(MASS, rotation=False), position=(0, 0, EDGE / 2)
    )
    pair = hapjax.Contact(
        5000.0, mu_static=STATIC, mu_kinetic=KINETIC, damping=1.0, between=("block", "floor")
    )
    scene = hapjax.Scene(
        {"block": block, "floor": hapjax.Object(hapjax.Plane())},
        {"pair": pair},
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    time = DT * np.arange(STEPS)
    down = np.minimum(time / 0.2, 1) * (DEPTH + 1e-3)
    hips = np.stack([SPEED * np.maximum(time - 0.5, 0), 0 * time, EDGE + 1e-3 - down], axis=1)[:, None]
    return hips, play(scene, hips)


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A block sticks and slips under a finger.")
    hips, reply = drag()
    time, pair = DT * np.arange(STEPS), reply.contact["pair"]
    friction, normal = -pair.friction_force[..., 0].sum(axis=1), pair.normal_force.sum(axis=1)
    ratio, x = friction[500:] / normal[500:], reply.pose[:, 0, 0]
    moving = np.diff(x) > 0.2 * SPEED * DT
    slips = np.count_nonzero(np.diff(moving[500:].astype(int)) == 1)
    print(f"friction over normal force: at most {ratio.max():.6f}, with mu_static {STATIC}")
    print(
        f"{slips} slips; while it sticks the block moves at {np.median(np.diff(x)[500:]) / DT * 1e3:.4f} mm/s"
    )
    save(
        out / "friction_cone.png",
        "time / s",
        ("x / mm", {"finger": (time, 1e3 * hips[:, 0, 0]), "block": (time, 1e3 * x)}),
        ("force / N", {"friction": (time, friction), "static limit": (time, STATIC * normal)}),
    )


if __name__ == "__main__":
    main()
