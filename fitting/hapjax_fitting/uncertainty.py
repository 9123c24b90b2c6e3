"""How well the data fix each parameter: covariance, intervals, and what they cannot tell."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Certainty:
    """What the whitened Jacobian says of the free numbers.

    `covariance` (p, p) of the unconstrained numbers, and `inverse`, (J'J)^-1; `identified` (p,): whether the data fix each;
    `singular_values` (p,) of the Jacobian with its columns scaled to length 1, largest first; `lost` (k, p):
    the directions, in those scaled numbers, that the data do not see at all.
    """

    covariance: np.ndarray
    inverse: np.ndarray
    identified: np.ndarray
    singular_values: np.ndarray
    lost: np.ndarray

    def widened(self, factors: np.ndarray, widest: np.ndarray) -> "Certainty":
        """The same with standard errors so many times as large."""
        covariance = self.covariance * np.outer(factors, factors)
        still = self.identified & (np.sqrt(np.diag(covariance)) < widest)
        return replace(self, covariance=covariance, identified=still)

    def tied_to(self, i: int) -> list[int]:
        """The numbers that the data cannot tell apart from number `i`."""
        seen = np.any((np.abs(self.lost) > 1e-3) & (np.abs(self.lost[:, [i]]) > 1e-3), axis=0)
        return [j for j in np.flatnonzero(seen).tolist() if j != i]


def certainty(
    jacobian: np.ndarray, variance: np.ndarray, widest: np.ndarray, usable: np.ndarray
) -> Certainty:
    """Gauss-Newton covariance (J'J)^-1 J'VJ (J'J)^-1 of a least-squares estimate.

    **Arguments:** `jacobian` (n, p), n at least p, of the residuals in the units they were fitted in;
    `variance` (n,), V's diagonal: what the residuals' variances turned out to be in those units (1: as
    assumed); `widest` (p,), the standard errors from which on a number counts as not identified; `usable`
    (p,): `False` for numbers known not to be identified.

    A direction is lost where its singular value is below the square root of the rounding error relative to
    the largest: there the Jacobian holds nothing but rounding. A number that has a part in a lost direction
    is not identified; the others keep their covariance.
    """
    length = np.sqrt(np.sum(jacobian**2, axis=0))
    usable = usable & (length > np.sqrt(np.finfo(jacobian.dtype).eps) * length.max(initial=0)) & (length > 0)
    count = jacobian.shape[1]
    covariance, whole, identified = np.zeros((count, count)), np.zeros((count, count)), usable.copy()
    if not usable.any():
        return Certainty(covariance, whole, identified, np.zeros(count), np.zeros((0, count)))
    scaled = (jacobian[:, usable] / length[usable]).astype(np.float64)
    left, values, right = np.linalg.svd(scaled, full_matrices=False)
    kept = values > np.sqrt(np.finfo(jacobian.dtype).eps) * values[0]
    lost_part = np.sum(right[~kept] ** 2, axis=0)
    inverse = right[kept].T / values[kept]
    middle = (left[:, kept] * variance[:, None]).T @ left[:, kept]
    lengths = np.outer(length[usable], length[usable])
    part = inverse @ middle @ inverse.T / lengths
    covariance[np.ix_(usable, usable)], whole[np.ix_(usable, usable)] = part, inverse @ inverse.T / lengths
    identified[usable] = (lost_part < 1e-6) & (np.sqrt(np.diag(part)) < widest[usable])
    all_values = np.zeros(count)
    all_values[: len(values)] = values
    lost = np.zeros((int(np.sum(~kept)), count))
    lost[:, usable] = right[~kept]
    return Certainty(covariance, whole, identified, all_values, lost)


def information(jacobian: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Fisher's information J'V^-1 J (p, p) of Gaussian residuals with the Jacobian (n, p) and the variances (n,)."""
    return np.einsum(
        "ni,n,nj->ij", jacobian, 1 / np.maximum(variance, np.finfo(float).tiny), jacobian, optimize=True
    )


def correlation(covariance: np.ndarray) -> np.ndarray:
    """The correlations of a covariance; 0 where a variance is 0."""
    deviation = np.sqrt(np.diag(covariance))
    product = np.outer(deviation, deviation)
    return np.divide(covariance, product, out=np.zeros_like(covariance), where=product > 0)
