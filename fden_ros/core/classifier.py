r"""Which tissue of a library an estimate belongs to, with probabilities.

For class c with prior p(c) and parameters :math:`\theta = (\ln G, \ln G_n, \alpha)` spread as
:math:`N(\mu_c, \Sigma_c)`, an estimate
:math:`\hat\theta` with covariance P has the evidence :math:`N(\hat\theta;\, \mu_c,\, \Sigma_c +
P)`. ``unknown`` is one more class, as wide as soft tissue is: what fits none of the others falls
to it. alpha counts only if it was learned from the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.estimator import Estimate

Array = NDArray[np.float64]

UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class Tissue:
    """One class of a library.

    Parameters
    ----------
    name : str
    mean : ndarray, shape (3,)
        Of (ln G, ln Gn, alpha), G in Pa s^alpha.
    covariance : ndarray, shape (3, 3)
        Spread of the class over specimens, positive definite.
    prior : float
        Prior probability up to a common factor, positive.
    """

    name: str
    mean: Array
    covariance: Array
    prior: float = 1.0


@dataclass(frozen=True, eq=False)
class TissueLibrary:
    """Tissues to tell apart, and the wide class of what is none of them."""

    name: str
    tissues: tuple[Tissue, ...]
    unknown: Tissue

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names in the order of the probabilities, ``unknown`` last."""
        return (*(tissue.name for tissue in self.tissues), UNKNOWN)


class ClassProbabilities(NamedTuple):
    """Probabilities of a library's classes, in its order, ``unknown`` last."""

    label: str
    names: tuple[str, ...]
    probabilities: tuple[float, ...]


def classify(
    library: TissueLibrary, estimate: Estimate, order_learned: bool
) -> ClassProbabilities:
    """Return the probability of every class given an estimate.

    Parameters
    ----------
    library : TissueLibrary
    estimate : Estimate
    order_learned : bool
        alpha was learned from the data, so that it says something of the tissue.
    """
    used = slice(0, 3 if order_learned else 2)
    value = np.array(
        [
            estimate.log_linear_stiffness,
            estimate.log_nonlinear_stiffness,
            estimate.fractional_order,
        ]
    )[used]
    classes = (*library.tissues, library.unknown)
    logs = np.array(
        [
            np.log(tissue.prior)
            + _log_density(
                value - tissue.mean[used], (tissue.covariance + estimate.covariance)[used, used]
            )
            for tissue in classes
        ]
    )
    probabilities = np.exp(logs - logs.max())
    probabilities /= probabilities.sum()
    names = library.class_names
    label = names[int(np.argmax(probabilities))]
    return ClassProbabilities(label, names, tuple(float(p) for p in probabilities))


def _log_density(deviation: Array, covariance: Array) -> float:
    """Log of the normal density, less the constant that all classes share."""
    distance = deviation @ np.linalg.solve(covariance, deviation)
    return float(-0.5 * (distance + np.linalg.slogdet(covariance)[1]))
