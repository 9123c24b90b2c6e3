"""A cube is put down corner first, and tilts over its corner and an edge onto a face: MHS 4.

python examples/cube_corner_to_face.py [--out DIR]
"""

import numpy as np
from plotting import G, at_rest, begin, play, save

import hapjax

MASS, EDGE, DT, STEPS = 0.2, 0.06, 1e-3, 3000
# The cube's diagonal upright is the turn (0.880, 0.325, -0.280, ...): a little off it, so that it does fall.
TILT = np.array([0.8880738, 0.3250576, -0.3250576, 0.0]) + np.array([0.0, 0.02, 0.05, 0.03])


def fall() -> hapjax.Reply:
    """Every reply after the cube's lowest corner has been put on the floor."""
    tilt = TILT / np.linalg.norm(TILT)
    cube = hapjax.Object(
        hapjax.Box((EDGE,) * 3), None, hapjax.Body(MASS), position=(0, 0, 0.052), orientation=tuple(tilt)
    )
    scene = hapjax.Scene(
        {"cube": cube, "floor": hapjax.Object(hapjax.Plane())},
        {"pair": hapjax.Contact(5000.0, mu=0.5, damping=1.0, between=("cube", "floor"))},
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    return play(scene, at_rest(np.full((1, 3), 9.0), STEPS))


def upright(pose: np.ndarray) -> np.ndarray:
    """The angle (T,) rad between the vertical and the nearest of the cube's axes."""
    w, x, y, z = pose[:, 3:].T
    rows = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)])
    return np.arccos(np.minimum(np.abs(rows).max(axis=0), 1))


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A cube is put down corner first.")
    reply = fall()
    time, pose = DT * np.arange(STEPS), np.asarray(reply.pose[:, 0])
    touching = (reply.contact["pair"].normal_force > 0).sum(axis=1)
    print(
        f"starts {np.degrees(upright(pose)[0]):.1f} deg off a face, ends {np.degrees(upright(pose)[-1]):.1e} deg off one"
    )
    print(
        f"touches with {touching[-1]} corners, centre at {pose[-1, 2] * 1e3:.3f} mm, half an edge is {EDGE * 500:g} mm"
    )
    save(
        out / "cube_corner_to_face.png",
        "time / s",
        ("off the nearest face / deg", {"cube": (time, np.degrees(upright(pose)))}),
        ("corners that touch", {"cube": (time, touching)}),
    )


if __name__ == "__main__":
    main()
