"""Forces of a grasp that belong to the other finger, or have the other sign: told apart, though its fingers press alike."""

from dataclasses import replace

import numpy as np
import pytest

from fitting_lies import found, lifted


@pytest.mark.parametrize("sigma", [0.03, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(2))
def test_swapped_fingers_and_reversed_forces_of_a_lift_are_told_apart(seed, sigma):
    """Where noise is large, by the weight that they carry."""
    clean = lifted(seed)
    assert clean.force is not None
    force = clean.force + sigma * np.random.default_rng(seed).standard_normal(clean.force.shape)
    assert found(replace(clean, force=force)) == (set(), "")
    swapped = replace(clean, force=force[:, ::-1])
    assert found(swapped)[0] == {("swapped fingers", "force")}
    kinds, said = found(replace(clean, force=-force))
    assert kinds == {("force sign", "force")}
    assert "force of finger 1 points into the surface" in said
