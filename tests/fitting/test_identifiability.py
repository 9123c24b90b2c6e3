"""What the data fix, said in words."""

import numpy as np
import pytest

from hapjax_fitting.identifiability import identifiability
from hapjax_fitting.parameters import Parameter
from hapjax_fitting.result import Estimate
from hapjax_fitting.transform import Identity, Log, Logit
from hapjax_fitting.uncertainty import certainty

RANDOM = np.random.default_rng(3)
SHOWN = RANDOM.standard_normal((50, 3)) * 100


def said(columns, names="abcd", transforms=None, seen=None, scale=1.0):
    """The sentences of a Jacobian with the given columns, the numbers being identified as a fit says it."""
    matrix = scale * np.stack(columns, axis=1)
    transforms = transforms or [Log()] * len(columns)
    seen = np.ones(len(columns), bool) if seen is None else np.array(seen)
    widest = np.array([t.widest for t in transforms])
    known = certainty(matrix, np.ones(len(matrix)), widest, seen)
    parameters = [Parameter(name, None, t) for name, t in zip(names, transforms, strict=False)]
    estimates = {
        p.name: Estimate(1.0, 0.1, (0.8, 1.2), bool(i), reason=None if i else "nothing slipped")
        for p, i in zip(parameters, known.identified, strict=True)
    }
    return identifiability(matrix.T @ matrix, parameters, estimates, seen, 3.0)


def test_all_fixed():
    assert said(SHOWN.T) == ("The data fix each of the free numbers on its own.",)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_product_and_a_ratio(noise, scale):
    """log a + log b: the product; log a - log b: the ratio; also where the rest is not quite nothing."""
    x, y, _ = SHOWN.T
    off = noise * RANDOM.standard_normal(50)
    assert said([x, x + off, y], scale=scale) == (
        "The data fix c.",
        "In these 3 s they fix a and b only through their product.",
    )
    assert said([y, x, -x + off], scale=scale) == (
        "The data fix a.",
        "In these 3 s they fix b and c only through their ratio.",
    )


def test_other_combinations():
    x, y, _ = SHOWN.T
    assert said([x, 3 * x]) == ("In these 3 s they fix a and b only through a combination.",)
    assert "a combination" in said([x, x], transforms=[Log(), Identity()])[0]
    assert "a combination" in said([x, x], transforms=[Logit(0.0, 1.0), Log()])[0]
    assert said([x, y, x + y]) == ("In these 3 s they fix a, b and c only through 2 combinations.",)
    assert said([x, x, y, y]) == (
        "In these 3 s they fix a and b only through their product.",
        "In these 3 s they fix c and d only through their product.",
    )


def test_one_that_nothing_shows():
    x, y, _ = SHOWN.T
    assert said([x, 0 * x, y]) == ("The data fix a and c.", "They do not fix b: nothing slipped.")
    assert said([x, 1e-6 * y])[-1] == "They do not fix b: nothing slipped."
    assert said([x, y], seen=[False, True])[-1] == "They do not fix a: nothing slipped."
    assert said([0 * x, 0 * x]) == (
        "They do not fix a: nothing slipped.",
        "They do not fix b: nothing slipped.",
    )


def test_an_identity_has_no_unit_to_be_wide_in():
    x, y, _ = SHOWN.T
    assert said([1e-6 * x, y], transforms=[Identity(), Log()])[0].startswith("The data fix each")
    assert said([1e-6 * x, 1e-6 * x, y], transforms=[Identity(), Identity(), Log()]) == (
        "The data fix c.",
        "In these 3 s they fix a and b only through a combination.",
    )


def test_of_what_nothing_is_seen_nothing_is_combined():
    x, y, _ = SHOWN.T
    assert said([x, x, y], seen=[False, False, True]) == (
        "The data fix c.",
        "They do not fix a: nothing slipped.",
        "They do not fix b: nothing slipped.",
    )
