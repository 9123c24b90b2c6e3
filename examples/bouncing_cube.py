"""A dropped cube bounces lower each time, and its energy never rises: MHS 4 and 6.

python examples/bouncing_cube.py [--out DIR]
"""

import jax
import jax.numpy as jnp
import numpy as np
from plotting import G, begin, save

import hapjax

MASS, EDGE, STIFFNESS, DAMPING, DT = 0.2, 0.06, 2000.0, 0.5, 1e-3
LEVEL, CORNER = (1.0, 0.0, 0.0, 0.0), (0.86, 0.42, 0.28, 0.06)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * EDGE / 2


def drop(
    orientation=LEVEL,
    substeps=5,
    damping: float | None = DAMPING,
    stiffness=STIFFNESS,
    seconds=1.5,
    method: type[hapjax.integrate.Integrator] = hapjax.Implicit,
):
    """The cube's motion and god-objects at every substep, and the mechanical energy (T,) J there."""
    cube = hapjax.Object(hapjax.Box((EDGE,) * 3), None, hapjax.Body(MASS), (0, 0, 0.15), orientation)
    scene = hapjax.Scene(
        {"cube": cube, "floor": hapjax.Object(hapjax.Plane())},
        {"pair": hapjax.Contact(stiffness, mu=0.5, damping=damping, between=("cube", "floor"))},
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=method(dt=DT / substeps),
    )
    away = jnp.full((1, 3), 9.0)

    def one(state, _):
        after, _ = hapjax.step(scene, state, away)
        motion = after.motion if method is hapjax.Implicit else state.motion  # when the forces were read
        return after, (motion["cube"], after.contact["pair"][0])

    count = round(seconds / DT * substeps)
    traced = jax.jit(lambda state: jax.lax.scan(one, state, None, count)[1])(hapjax.init(scene, away))
    motion, gods = jax.tree.map(np.asarray, traced)
    return motion, energy(motion, gods, stiffness)


def energy(motion, gods, stiffness) -> np.ndarray:
    """Of motion, of height, and of the springs normal and tangential to the floor."""
    w, x, y, z = motion.orientation.T
    turn = np.array(
        [
            [1 - 2 * (y**2 + z**2), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x**2 + z**2), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)],
        ]
    )
    corners = motion.position[:, None] + np.einsum("ijt,vj->tvi", turn, CORNERS)
    depth = np.maximum(-corners[..., 2], 0)
    stretch = (gods.depth > 0) * np.sum((gods.point - corners)[..., :2] ** 2, axis=-1)
    kinetic = MASS / 2 * np.sum(motion.velocity**2, axis=1) + MASS * EDGE**2 / 12 * np.sum(
        motion.spin**2, axis=1
    )
    return kinetic + MASS * G * motion.position[:, 2] + stiffness / 2 * (depth**2 + stretch).sum(axis=1)


def apexes(motion) -> np.ndarray:
    """The heights (m) of the cube's centre at the top of each bounce."""
    speed = motion.velocity[:, 2]
    return motion.position[1:, 2][(speed[:-1] > 0) & (speed[1:] <= 0) & (motion.position[1:, 2] > EDGE / 2)]


def main() -> None:
    """Print the key numbers and write the plot."""
    out = begin("A dropped cube bounces.")
    heights, energies = {}, {}
    for name, orientation in (("level", LEVEL), ("corner first", CORNER)):
        motion, joules = drop(orientation)
        time = DT / 5 * np.arange(len(joules))
        heights[name], energies[name] = (time, 1e3 * motion.position[:, 2]), (time, 1e3 * joules)
        rise = np.max(joules - np.minimum.accumulate(joules)) / joules[0]
        print(f"{name}: energy never rises by more than {rise:.1e} of its start")
        if orientation == LEVEL:
            print("apexes: " + ", ".join(f"{1e3 * h:.2f}" for h in apexes(motion)[:6]) + " mm")
    save(out / "bouncing_cube.png", "time / s", ("height / mm", heights), ("energy / mJ", energies))


if __name__ == "__main__":
    main()
