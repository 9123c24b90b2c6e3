import numpy as np
import pytest

from hapjax_fitting.uncertainty import certainty, correlation

RANDOM = np.random.default_rng(1)
J = RANDOM.standard_normal((60, 3)) * [1.0, 50.0, 0.02]
WIDE, ALL = np.full(3, np.inf), np.ones(3, bool)


def test_covariance_of_a_linear_model_is_that_of_the_normal_equations():
    known = certainty(J, np.full(60, 4.0), WIDE, ALL)
    np.testing.assert_allclose(known.covariance, 4 * np.linalg.inv(J.T @ J), rtol=1e-9)
    assert known.identified.all() and known.lost.shape == (0, 3)


def test_a_line_through_points_has_the_textbook_variances():
    x = np.linspace(0, 2, 21)
    known = certainty(np.stack([np.ones_like(x), x], axis=1), np.full(21, 0.09), WIDE[:2], ALL[:2])
    spread = np.sum((x - 1) ** 2)
    np.testing.assert_allclose(
        np.diag(known.covariance), [0.09 * (1 / 21 + 1 / spread), 0.09 / spread], rtol=1e-12
    )


def test_unequal_variances_give_the_spread_of_unweighted_estimates():
    variance = RANDOM.uniform(0.5, 4, 60)
    known = certainty(J, variance, WIDE, ALL)
    errors = np.sqrt(variance) * RANDOM.standard_normal((20_000, 60))
    estimates = errors @ np.linalg.pinv(J).T
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)), estimates.std(axis=0), rtol=0.03)


def test_a_number_without_effect_is_not_identified_and_the_others_are():
    known = certainty(J * [1, 0, 1], np.ones(60), WIDE, ALL)
    np.testing.assert_array_equal(known.identified, [True, False, True])
    rest = np.linalg.inv(J[:, [0, 2]].T @ J[:, [0, 2]])
    np.testing.assert_allclose(known.covariance[np.ix_([0, 2], [0, 2])], rest, rtol=1e-9)


def test_two_numbers_that_only_their_product_shows_are_tied():
    matrix = np.stack([J[:, 0], 3 * J[:, 0], J[:, 1]], axis=1)
    known = certainty(matrix, np.ones(60), WIDE, ALL)
    np.testing.assert_array_equal(known.identified, [False, False, True])
    assert known.tied_to(0) == [1] and known.tied_to(1) == [0] and known.tied_to(2) == []
    assert known.covariance[2, 2] == pytest.approx(
        1 / np.sum(J[:, 1] ** 2) / (1 - cosine(J[:, 0], J[:, 1]) ** 2)
    )


def test_an_almost_tied_pair_is_identified_with_a_correlation_near_1():
    near = J[:, 0] + 1e-3 * RANDOM.standard_normal(60)
    known = certainty(np.stack([J[:, 0], near], axis=1), np.ones(60), WIDE[:2], ALL[:2])
    assert known.identified.all()
    assert correlation(known.covariance)[0, 1] < -0.999


def test_too_wide_is_not_identified():
    known = certainty(J, np.ones(60), np.array([1e-3, np.inf, np.inf]), ALL)
    np.testing.assert_array_equal(known.identified, [False, True, True])


def test_what_is_known_not_to_be_identified_is_left_out():
    known = certainty(J, np.ones(60), WIDE, np.array([True, False, True]))
    np.testing.assert_array_equal(known.identified, [True, False, True])
    assert not certainty(J, np.ones(60), WIDE, ~ALL).identified.any()


def test_correlation_where_a_variance_is_0():
    np.testing.assert_array_equal(correlation(np.diag([4.0, 0.0])), np.diag([1.0, 0.0]))


def cosine(a, b):
    return a @ b / np.linalg.norm(a) / np.linalg.norm(b)
