"""What is compiled: once, and nothing of a part that is absent."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax

HIP = np.array([[0.029, 0.0, 0.03], [-0.029, 0.0, 0.03]])


NO_TURNING = dict(torsion=False, dead_band=None, gyroscopic=False, inertia=None, centre=None)


def full(**without):
    """A scene with every part, less those given as None or with another value."""
    part = dict(damping=1.0, kinetic=0.4, torsion=True, twist_damping=1e-4, dead_band=1e-5, gyroscopic=True)
    part |= dict(gravity=(0, 0, -9.81), rotation=True, contact=True, pair_damping=0.5, substeps=2, body=True)
    part |= dict(second=True, inertia=(1e-4,) * 3, centre=(1e-3, 0, 0), faces=False) | without
    mu = (0.6,) * 6 if part["faces"] else 0.6
    law = (
        dict(mu=mu)
        if part["kinetic"] is None
        else dict(mu_static=mu, mu_kinetic=0.4 if np.ndim(mu) == 0 else mu)
    )
    surface = hapjax.Surface(800.0, damping=part["damping"], **law)
    body = hapjax.Body(0.2, part["inertia"], part["centre"], part["rotation"]) if part["body"] else None
    objects = {"cube": hapjax.Object(hapjax.Box((0.06,) * 3), surface, body, (0, 0, 0.03))}
    objects["floor"] = hapjax.Object(hapjax.Plane())
    if part["second"]:
        objects["ball"] = hapjax.Object(hapjax.Sphere(0.02), hapjax.Surface(500.0, mu=0.3), None, (0.3, 0, 0))
    pair = hapjax.Contact(5000.0, mu=0.5, damping=part["pair_damping"], between=("cube", "floor"))
    return hapjax.Scene(
        object=objects,
        contact={"cube_on_floor": pair} if part["contact"] else {},
        torsion=hapjax.GravityDrop(2e-5, part["twist_damping"]) if part["torsion"] else None,
        world=hapjax.World(part["gravity"], part["gyroscopic"], part["dead_band"]),
        integrator=hapjax.SemiImplicit(substeps=part["substeps"]),
    )


def equations(jaxpr) -> int:
    """The number of primitive equations; an equation that only holds inner jaxprs counts as what they hold."""
    count = 0
    for equation in jaxpr.eqns:
        inner = [leaf for leaf in jax.tree.leaves(tuple(equation.params.values())) if hasattr(leaf, "eqns")]
        count += sum(map(equations, inner)) if inner else 1
    return count


def program(scene):
    """The jaxpr of one step."""
    return jax.make_jaxpr(hapjax.step)(scene, hapjax.init(scene, HIP), jnp.asarray(HIP)).jaxpr


def paths(tree):
    return [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(tree)]


# Each part: how it is left out, what it cannot be without, a word that no number's path may have then, and how it is
# taken out of a scene that had it.
PARTS = {
    "damping": (dict(damping=None), {}, ".surface.damping", lambda s: s.object["cube"].surface.damping),
    "kinetic friction": (dict(kinetic=None), {}, "mu_kinetic", None),
    "mu of each face": (dict(faces=False), dict(faces=True), None, None),
    "contact's damping": (
        dict(pair_damping=None),
        {},
        "].damping",
        lambda s: s.contact["cube_on_floor"].damping,
    ),
    "torsion": (dict(torsion=False), {}, "torsion", lambda s: s.torsion),
    "twist damping": (dict(twist_damping=None), {}, "twist_damping", lambda s: s.torsion.twist_damping),
    "dead band": (dict(dead_band=None), {}, "dead_band", lambda s: s.world.dead_band),
    "gyroscopic term": (dict(gyroscopic=False), {}, None, None),
    "gravity": (dict(gravity=None), {}, "gravity", lambda s: s.world.gravity),
    "centre": (dict(centre=None), {}, "centre", lambda s: s.object["cube"].body.centre),
    "contact": (dict(contact=False), {}, "contact", None),
    "second object": (dict(second=False), {}, "ball", None),
    "substeps": (dict(substeps=1), dict(damping=None), None, None),
    "rotation": (dict(rotation=False), NO_TURNING, "spin", None),
    "body": (dict(body=False), NO_TURNING | dict(contact=False), "motion", None),
}


@pytest.mark.parametrize("part", PARTS)
def test_an_absent_part_costs_nothing(part):
    without, also, word, where = PARTS[part]
    having, lacking = full(**also), full(**(also | without))
    more, less = program(having), program(lacking)
    assert equations(less) < equations(more)
    # What goes into the step is what scene and state hold, and no word of the part is in either.
    held = paths((lacking, hapjax.init(lacking, HIP)))
    assert len(less.invars) == len(held) + 1
    if word is not None:
        assert any(word in path for path in paths((having, hapjax.init(having, HIP))))
        assert not any(word in path for path in held)
    if where is not None:
        taken_out = eqx.tree_at(where, having, None)
        assert str(program(taken_out)) == str(less)


def test_every_number_of_a_moving_scene_is_used():
    """The other way round: a parameter that is given has equations of its own."""
    scene = full(second=False)
    jaxpr = program(scene)
    (call,) = jaxpr.eqns
    inner = call.params["jaxpr"].jaxpr
    read = {id(v) for equation in inner.eqns for v in equation.invars} | {id(v) for v in inner.outvars}
    idle = {
        path
        for path, outer in zip(paths(scene), jaxpr.invars, strict=False)
        if id(inner.invars[call.invars.index(outer)]) not in read
    }
    # Where a moving object starts is read by init only.
    assert idle == {".object['cube'].position", ".object['cube'].orientation"}


# Compiling once -------------------------------------------------------------------------------------------


def programs() -> int:
    """How many programs of `step` JAX holds."""
    return hapjax.step._cache_size()  # pyright: ignore[reportAttributeAccessIssue]


def test_steps_that_follow_each_other_share_one_program(dtype):
    scene = hapjax.cast(full(second=False), dtype)
    state = hapjax.init(scene, HIP)
    hip = jnp.asarray(HIP, dtype)
    before = programs()
    for k in range(1, 4):  # with other numbers in the scene too
        stiffer = eqx.tree_at(
            lambda s: s.object["cube"].surface.stiffness, scene, replace_fn=lambda x, k=k: x * k
        )
        state, _ = hapjax.step(stiffer, state, hip + 1e-5 * k)
    assert programs() == before + 1
    state, _ = hapjax.step(scene, state, hip, 1e-3)
    assert programs() == before + 2
    hapjax.step(scene, state, hip, 2e-3)
    assert programs() == before + 2


def test_state_is_strongly_typed(dtype):
    scene = hapjax.cast(full(), dtype)
    state = hapjax.init(scene, HIP)
    after, reply = jax.eval_shape(hapjax.step, scene, state, jnp.asarray(HIP, dtype))
    for leaf in jax.tree.leaves((scene, state, after, reply)):
        assert leaf.dtype == dtype and not leaf.weak_type
    assert jax.tree.map(jnp.shape, state) == jax.tree.map(jnp.shape, after)
