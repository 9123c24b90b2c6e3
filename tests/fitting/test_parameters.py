import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from fitting_cases import floor, held_cube
from hapjax_fitting.parameters import find_leaf, free_parameters, values_of, with_values
from hapjax_fitting.transform import Identity, Log, Logit

PATHS = [
    "object.cube.surface.mu",
    "contact.cube_on_floor.mu",
    "object.cube.body.mass",
    "object.cube.size",
    "world.gravity",
]


def select(s):
    return (
        s.object["cube"].surface.mu,
        s.contact["cube_on_floor"].mu,
        s.object["cube"].body.mass,
        s.object["cube"].shape.size,
        s.world.gravity,
    )


def test_a_function_selects_what_paths_name():
    scene = held_cube()
    assert free_parameters(scene, select) == free_parameters(scene, PATHS)
    assert [p.name for p in free_parameters(scene, select)][:4] == [*PATHS[:3], "object.cube.size[0]"]


def test_one_path_may_stand_alone():
    assert [p.name for p in free_parameters(floor(), "object.floor.surface.mu")] == [
        "object.floor.surface.mu"
    ]


def test_indices_pick_one_number_of_a_list():
    scene = held_cube()
    (parameter,) = free_parameters(scene, ["object.cube.body.inertia[2]"])
    assert (parameter.path, parameter.index) == ("object.cube.body.inertia", 2)
    changed = with_values(scene, (parameter,), jnp.array([9e-5]))
    np.testing.assert_array_equal(find_leaf(changed, parameter.path), [1.2e-4, 1.2e-4, 9e-5])
    assert float(values_of(changed, (parameter,))[0]) == 9e-5


def test_only_the_named_leaves_change():
    scene = held_cube()
    parameters = free_parameters(scene, PATHS)
    values = np.asarray(values_of(scene, parameters))
    changed = with_values(scene, parameters, jnp.asarray(values * 2))
    np.testing.assert_array_equal(values_of(changed, parameters), values * 2)
    rest = free_parameters(scene, ["object.cube.surface.stiffness", "object.cube.position"])
    np.testing.assert_array_equal(values_of(changed, rest), values_of(scene, rest))


def test_transforms_follow_the_kind_of_number():
    parameters = free_parameters(held_cube(), PATHS, {"object.cube.surface.mu": (0.1, 2.0)})
    kinds = [p.transform for p in parameters]
    assert kinds[0] == Logit(0.1, 2.0)
    assert kinds[1:] == [Log()] * 5 + [Identity()] * 3


def test_bounds_of_a_list_hold_for_each_of_its_numbers_or_for_one():
    scene, path = held_cube(), "object.cube.body.inertia"
    whole = free_parameters(scene, [path], {path: (1e-5, 1e-3)})
    assert [p.transform for p in whole] == [Logit(1e-5, 1e-3)] * 3
    one = free_parameters(scene, [path], {f"{path}[1]": (1e-5, 1e-3)})
    assert [p.transform for p in one] == [Log(), Logit(1e-5, 1e-3), Log()]


MU = "object.cube.surface.mu"


@pytest.mark.parametrize(
    ("free", "bounds", "message"),
    [
        ([], None, "free is empty"),
        (["object.cub.surface.mu"], None, "object has no cub; allowed: object.cube"),
        (["object.cube.surface"], None, "is a part of the scene, not a number; allowed: .*surface.stiffness"),
        (["object.cube.surface.mu_static"], None, "leaves out object.cube.surface.mu_static"),
        (["torsion.critical_area"], None, "leaves out torsion"),
        (["object..mu"], None, "part without a name"),
        ([""], None, "free has an empty path"),
        (["object.cube.surface.mu[0]"], None, "out of range"),
        (["object.cube.body.inertia[3]"], None, r"allowed: object.cube.body.inertia\[0\] to \[2\]"),
        (["object.cube.body.inertia[\u0661]"], None, "object.cube.body has no inertia"),
        (["integrator.dt"], None, "^integrator.dt is not physical; allowed: object, contact, world$"),
        (["integrator"], None, "^integrator is not physical"),
        (["integrator.substeps"], None, "^integrator.substeps is not physical"),
        (lambda s: s.integrator.dt, None, "^integrator.dt is not physical"),
        (["gravity"], None, "the scene has no gravity; allowed: object, contact, world$"),
        ([MU, MU], None, "twice"),
        (["object.cube.body.inertia", "object.cube.body.inertia[0]"], None, "twice"),
        (lambda s: 3.0, None, "free selects 3.0"),
        (lambda s: (s.object["cube"].surface.mu, "mu"), None, "free selects 'mu'"),
        ([MU], {"object.cube.body.mass": (0.1, 1.0)}, "which is not free"),
        ([MU], {MU: (1.0, 0.1)}, "the lower first"),
        ([MU], {MU: (-1.0, 0.7)}, "begin at -1; allowed: 0 or above"),
        ([MU], {MU: (0.1, np.inf)}, "two finite numbers"),
        ([MU], {MU: (0.1, 0.5)}, "starts at 0.6; allowed: between its bounds 0.1 and 0.5"),
    ],
)
def test_refusals(free, bounds, message):
    with pytest.raises(hapjax.InputError, match=message):
        free_parameters(held_cube(), free, bounds)


def test_a_mu_of_0_cannot_start_a_fit():
    with pytest.raises(hapjax.InputError, match="starts at 0; allowed for a free parameter: above 0"):
        free_parameters(floor(mu=0.0), ["object.floor.surface.mu"])


def test_a_full_inertia_matrix_is_refused():
    cube = hapjax.Object(hapjax.Box((1, 1, 1)), body=hapjax.Body(1.0, inertia=np.eye(3)))
    with pytest.raises(hapjax.InputError, match="is a matrix"):
        free_parameters(hapjax.Scene(object={"cube": cube}), ["object.cube.body.inertia"])
