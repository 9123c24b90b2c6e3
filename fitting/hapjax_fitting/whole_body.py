"""Mass, centre and inertia of a body, free together: ten numbers, and whatever they are, a real body has them.

The pseudo-inertia matrix J = [[S, m c], [m c', m]], S the second moments of mass about the frame's origin, is positive
definite exactly for bodies whose moments obey the triangle inequality. The ten numbers are those of its upper triangular
factor, J = U U', with logarithms on the diagonal: Rucker and Wensing 2022, Smooth parameterization of rigid-body inertia,
IEEE Robotics and Automation Letters 7, equations 9 to 12. U = exp(a) [[exp(d1), s12, s13, t1], [0, exp(d2), s23, t2],
[0, 0, exp(d3), t3], [0, 0, 0, 1]], so that the mass is exp(2 a), and the t are the centre.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapjax import Body, InputError, Object, Scene
from hapjax.body import centre_within, inertia_of

from .transform import Identity, Log, Transform

NAME = "pseudo_inertia"
COUNT = 10
# How far off each number may well be: half a logarithm, or a centimetre.
SIZES = (0.5,) * 4 + (1e-2,) * 6
_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def is_whole(path: str) -> bool:
    """Whether a path is that of a whole body's ten numbers."""
    return path.rsplit(".", 1)[-1] == NAME


def numbers_of(
    mass: Float[Array, ""], centre: Float[Array, "3"], inertia: Float[Array, "3 3"]
) -> Float[Array, "10"]:
    """a, d1, d2, d3, s12, s23, s13, t1, t2, t3 of a mass (kg), a centre (m) and the inertia about it (kg m^2)."""
    moments = (0.5 * jnp.trace(inertia) * jnp.eye(3, dtype=inertia.dtype) - inertia) / mass
    upper = jnp.linalg.cholesky(moments[::-1, ::-1])[::-1, ::-1]
    off = jnp.stack([upper[0, 1], upper[1, 2], upper[0, 2]])
    return jnp.concatenate([0.5 * jnp.log(mass)[None], jnp.log(jnp.diagonal(upper)), off, centre])


def body_of(
    numbers: Float[Array, "10"],
) -> tuple[Float[Array, ""], Float[Array, "3"], Float[Array, "3 3"]]:
    """The mass (kg), the centre (m) and the inertia about it (kg m^2) of the ten numbers."""
    mass, (d1, d2, d3), (s12, s23, s13) = jnp.exp(2 * numbers[0]), jnp.exp(numbers[1:4]), numbers[4:7]
    zero = jnp.zeros_like(d1)
    upper = jnp.stack([jnp.stack([d1, s12, s13]), jnp.stack([zero, d2, s23]), jnp.stack([zero, zero, d3])])
    # Not `@`, which accelerators round to TF32.
    moments = mass * jnp.sum(upper[:, None, :] * upper[None, :, :], axis=-1)
    inertia = jnp.trace(moments) * jnp.eye(3, dtype=numbers.dtype) - moments
    return mass, numbers[7:], inertia


def of_leaf(body: Body) -> Float[Array, "10"]:
    """The ten numbers of a body that `made_explicit` gave."""
    assert body.centre is not None and body.inertia is not None
    return numbers_of(body.mass, body.centre, body.inertia)


def made_explicit(scene: Scene, paths: Sequence[str]) -> Scene:
    """The scene, with centre and 3x3 inertia written out for those bodies whose ten numbers are free."""
    for path in paths:
        kind, name, part, *rest = [*path.split("."), "", "", ""]
        if (kind, part, rest[0]) != ("object", "body", NAME) or name not in scene.object:
            continue
        thing = scene.object[name]
        if thing.body is None:
            continue
        if not thing.body.rotation:
            raise InputError(f"{path}: the body does not rotate; allowed: its mass, or a body with rotation")
        scene = eqx.tree_at(lambda s, n=name: s.object[n].body, scene, _explicit(thing, thing.body))
    return scene


def _explicit(thing: Object, body: Body) -> Body:
    inertia, centre = inertia_of(body, thing.shape), centre_within(body, thing.shape)
    inertia = jnp.diag(inertia) if inertia.ndim == 1 else inertia
    return Body(body.mass, inertia, jnp.zeros_like(inertia[0]) if centre is None else centre)


def shown(path: str) -> list[tuple[str, int | None, Transform]]:
    """What stands in a result for the ten numbers: path, index and transform of mass, centre and inertia."""
    body = path.removesuffix(f".{NAME}")
    found: list[tuple[str, int | None, Transform]] = [(f"{body}.mass", None, Log())]
    found += [(f"{body}.centre", i, Identity()) for i in range(3)]
    for i, j in _ENTRIES:
        found.append((f"{body}.inertia[{i}][{j}]", None, Log() if i == j else Identity()))
    return found


def as_shown(numbers: Float[Array, "10"]) -> Float[Array, "10"]:
    """Mass, centre and inertia as `shown` has them, logarithms where it has them."""
    mass, centre, inertia = body_of(numbers)
    entries = [jnp.log(inertia[i, j]) if i == j else inertia[i, j] for i, j in _ENTRIES]
    return jnp.concatenate([jnp.log(mass)[None], centre, jnp.stack(entries)])
