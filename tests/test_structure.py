"""What is compiled: once, and nothing of a part that is absent."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.benchmark.scene import equations, without_each_part

HIP = np.array([[0.029, 0.0, 0.03], [-0.029, 0.0, 0.03]])


NO_TURNING = dict(torsion=False, dead_band=None, gyroscopic=False, inertia=None, centre=None)


def full(**without: Any):
    """A scene with every part, less those given as None or with another value."""
    part: dict[str, Any] = dict(
        damping=1.0, kinetic=0.4, torsion=True, twist_damping=1e-4, dead_band=1e-5, gyroscopic=True
    )
    part |= dict(gravity=(0, 0, -9.81), rotation=True, contact=True, pair_damping=0.5, substeps=2, body=True)
    part |= dict(second=True, inertia=(1e-4,) * 3, centre=(1e-3, 0, 0), faces=False) | without
    part = dict(friction=None, tangential=None, anisotropy=None, other_contact=False, fingers=None) | part
    mu = (0.6,) * 6 if part["faces"] else 0.6
    law = (
        dict(mu=mu)
        if part["kinetic"] is None
        else dict(mu_static=mu, mu_kinetic=0.4 if np.ndim(mu) == 0 else mu)
    )
    law: dict[str, Any] = law | dict(friction=part["friction"], tangential_stiffness=part["tangential"])
    law |= dict(finger_mu=part["fingers"])
    if part["anisotropy"] is not None:
        law |= dict(anisotropy=part["anisotropy"], grain=(1.0, 0.0, 0.0))
    surface = hapjax.Surface(800.0, damping=part["damping"], **law)
    body = hapjax.Body(0.2, part["inertia"], part["centre"], part["rotation"]) if part["body"] else None
    objects = {"cube": hapjax.Object(hapjax.Box((0.06,) * 3), surface, body, (0, 0, 0.03))}
    objects["floor"] = hapjax.Object(hapjax.Plane())
    if part["second"]:
        objects["ball"] = hapjax.Object(hapjax.Sphere(0.02), hapjax.Surface(500.0, mu=0.3), None, (0.3, 0, 0))
    pair = hapjax.Contact(5000.0, mu=0.5, damping=part["pair_damping"], between=("cube", "floor"))
    contacts = {"cube_on_floor": pair} if part["contact"] else {}
    if part["other_contact"]:
        contacts["cube_on_ball"] = hapjax.Contact(4000.0, mu=0.3, between=("cube", "ball"))
    return hapjax.Scene(
        object=objects,
        contact=contacts,
        torsion=hapjax.GravityDrop(2e-5, part["twist_damping"]) if part["torsion"] else None,
        world=hapjax.World(part["gravity"], part["gyroscopic"], part["dead_band"]),
        integrator=hapjax.SemiImplicit(substeps=part["substeps"]),
    )


def program(scene, gimbal=None):
    """The jaxpr of one step."""
    state = hapjax.init(scene, HIP, gimbal)
    return jax.make_jaxpr(hapjax.step)(scene, state, jnp.asarray(HIP), gimbal=gimbal).jaxpr


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
    "contact with another object": (
        dict(other_contact=False),
        dict(other_contact=True),
        "cube_on_ball",
        None,
    ),
    "friction law": (
        dict(friction=None),
        dict(friction=hapjax.Stribeck(0.01, viscous=0.1)),
        "friction.",
        lambda s: s.object["cube"].surface.friction,
    ),
    "tangential stiffness": (
        dict(tangential=None),
        dict(tangential=600.0),
        "tangential",
        lambda s: s.object["cube"].surface.tangential_stiffness,
    ),
    "anisotropy": (dict(anisotropy=None), dict(anisotropy=0.5), "anisotropy", None),
    "mu of each finger": (
        dict(fingers=None),
        dict(fingers=(1.0, 0.8)),
        "finger_mu",
        lambda s: s.object["cube"].surface.finger_mu,
    ),
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
    # A tangential stiffness takes the place of the stiffness: it is one number more, and no equation.
    assert equations(less) < equations(more) or part == "tangential stiffness"
    # What goes into the step is what scene and state hold, and no word of the part is in either.
    held = paths((lacking, hapjax.init(lacking, HIP)))
    assert len(less.invars) == len(held) + 1
    if word is not None:
        assert any(word in path for path in paths((having, hapjax.init(having, HIP))))
        assert not any(word in path for path in held)
    if where is not None:
        taken_out = eqx.tree_at(where, having, None)
        assert str(program(taken_out)) == str(less)


def test_gimbals_god_angles_and_pivots_cost_only_those_who_ask_for_them():
    base, still = full(), np.zeros(2)
    drop, none = replace(base, torsion=hapjax.GravityDrop(2e-5)), full(torsion=False)
    turned, soft = (
        replace(base, torsion=hapjax.Gimbal(2e-5)),
        replace(base, torsion=hapjax.SoftFinger(1e-3, 0.1)),
    )
    pivoted = replace(base, integrator=hapjax.PivotForm(substeps=2))
    assert equations(program(drop)) < equations(program(turned, still))
    assert equations(program(none)) < equations(program(soft))
    assert equations(program(base)) < equations(program(pivoted))
    # In the state only then, and as an argument of the step only then.
    assert len(program(turned, still).invars) == len(program(drop).invars) + 2
    for scene, gimbal, angles in ((turned, still, 1), (soft, None, 1), (drop, None, 0), (none, None, 0)):
        state = hapjax.init(scene, HIP, gimbal)
        assert len(jax.tree.leaves((state.gimbal, state.god_angle))) == angles
    assert len(program(pivoted).invars) == len(program(base).invars)


@pytest.mark.slow
def test_the_benchmark_switches_off_what_costs():
    """Every part of a full scene is among those that `hapjax benchmark scene` leaves out, and each saves equations."""
    scene = full(
        friction=hapjax.Stribeck(0.01),
        tangential=600.0,
        anisotropy=0.5,
        other_contact=True,
        faces=True,
        fingers=(1.0, 0.8),
    )
    whole = equations(program(scene))
    found = dict(without_each_part(scene))
    assert {name.split(".")[-1] for name in found} >= {
        *(
            "friction",
            "damping",
            "tangential_stiffness",
            "mu_kinetic",
            "anisotropy",
            "finger_mu",
            "mu of each face",
            "surface",
        ),
        *(
            "centre",
            "rotation",
            "body",
            "cube",
            "floor",
            "ball",
            "cube_on_floor",
            "cube_on_ball",
            "twist_damping",
        ),
        *("torsion", "gravity", "gyroscopic", "dead_band", "substeps"),
    }
    for name, variant in found.items():
        assert equations(program(variant)) < whole or name.endswith("tangential_stiffness"), name


@pytest.mark.slow
def test_the_benchmark_switches_off_shading():
    tips = 0.02 * np.concatenate([np.eye(3), -np.eye(3)])
    octants = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    stone = hapjax.Mesh(tips, octants, shaded=True)
    scene = hapjax.Scene({"stone": hapjax.Object(stone, hapjax.Surface(500.0, mu=0.3))})
    plain = dict(without_each_part(scene))["object.stone.shaded"]
    assert vars(plain.object["stone"].shape)["shaded"] is False
    assert equations(program(plain)) != equations(program(scene))


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
    assert reply.lost.dtype == jnp.dtype(bool)
    for leaf in jax.tree.leaves((scene, state, after, reply.force, reply.pose, reply.touch, reply.contact)):
        assert leaf.dtype == dtype and not leaf.weak_type
    assert jax.tree.map(jnp.shape, state) == jax.tree.map(jnp.shape, after)
