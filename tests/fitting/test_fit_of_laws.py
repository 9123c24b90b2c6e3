"""The numbers of friction laws are fitted by the paths that they have in scene files."""

from typing import Any

import pytest

import hapjax
from fitting_cases import SIGMA, floor, recorded
from hapjax_fitting import fit
from hapjax_fitting.parameters import find_leaf, free_parameters
from hapjax_fitting.transform import Identity, Log

FRICTION = "object.floor.surface.friction."
MU_KINETIC = "object.floor.surface.mu_kinetic"
TWO = dict(mu_static=0.6, mu_kinetic=0.4)


def test_paths_reach_into_laws_of_surfaces_and_contacts():
    scene = hapjax.Scene(
        {
            "it": hapjax.Object(hapjax.Box((0.1,) * 3), None, hapjax.Body(0.1)),
            "floor": hapjax.Object(
                hapjax.Plane(),
                hapjax.Surface(
                    800.0, anisotropy=0.5, grain=(1, 0, 0), friction=hapjax.LuGre(0.01, 0.5, 0.02), **TWO
                ),
            ),
        },
        {"pair": hapjax.Contact(1000.0, between=("it", "floor"), friction=hapjax.Karnopp(1e-3), **TWO)},
    )

    def pick(s: Any):
        felt = s.object["floor"].surface
        return felt.friction.stribeck_velocity, s.contact["pair"].friction.velocity_band, felt.grain

    found = free_parameters(scene, pick)
    paths = [FRICTION + "stribeck_velocity", "contact.pair.friction.velocity_band"]
    assert [p.path for p in found[:2]] == paths
    assert isinstance(found[0].transform, Log) and isinstance(found[2].transform, Identity)
    assert float(find_leaf(scene, FRICTION + "bristle_damping")) == 0.01
    with pytest.raises(hapjax.InputError, match=r"no sigma; allowed: .*friction\.bristle_damping"):
        find_leaf(scene, FRICTION + "sigma")


@pytest.mark.slow
@pytest.mark.parametrize("law", [hapjax.Stribeck, hapjax.LuGre])
def test_viscous_friction_is_recovered(law):
    """A stroke at up to 0.16 m/s, with noise; the fit starts at a quarter of the truth."""

    def scene(b):
        made = {
            hapjax.Stribeck: lambda: hapjax.Stribeck(0.02, b),
            hapjax.LuGre: lambda: hapjax.LuGre(0.01, b, 0.02),
        }[law]()
        return floor(friction=made, **TWO)

    name = FRICTION + "viscous"
    result = fit(scene(0.25), recorded(scene(1.0), seed=1), [name, MU_KINETIC], starts=1)
    found = result.parameters[name]
    low, high = found.interval95
    assert found.identified and low is not None and high is not None and low < 1.0 < high
    assert found.estimate == pytest.approx(1.0, rel=0.05)
    assert result.residual_rms["force"] == pytest.approx(SIGMA, rel=0.1)
    assert result.parameters[MU_KINETIC].estimate == pytest.approx(0.4, rel=0.02)
