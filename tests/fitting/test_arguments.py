"""What a fit is asked for, by those who have no type checker."""

import pytest

from fitting_cases import MU, floor
from hapjax import InputError
from hapjax_fitting.arguments import check_names, check_recordings
from hapjax_fitting.parameters import paths_of


@pytest.mark.parametrize("free", [3, [MU, 3], [None]])
def test_free_numbers_without_a_name_are_refused(free):
    with pytest.raises(InputError, match="free names (3|None); allowed: paths"):
        check_names(free)


@pytest.mark.parametrize("free", ["", [MU, " "]])
def test_an_empty_path_is_refused(free):
    with pytest.raises(InputError, match="free has an empty path; allowed: paths, such as object"):
        paths_of(floor(), free)


def test_what_is_not_by_name_is_refused():
    check_names(MU, noise=None, bounds={})
    check_names(lambda s: s)
    with pytest.raises(InputError, match=r"noise is \[0.1\]; allowed: a dict by names"):
        check_names([MU], noise=[0.1])


def test_what_is_no_recording_is_refused():
    with pytest.raises(InputError, match="lift is 'lift.npz'; allowed: a Recording"):
        check_recordings(floor(), ["lift.npz"], ["lift"], ("force",))
