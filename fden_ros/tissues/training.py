# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Tissue libraries from labelled contacts, the estimation error taken out.

Contact j with specimen s of a class shows :math:`\theta_{sj} = \mu + b_s + w_{sj}` through its
likelihood. :math:`\mu`, the covariance B between specimens and W within them come from expectation
and maximisation, with the uncertainty of :math:`\mu` counted (restricted maximum likelihood; N.
Laird and J. Ware, Biometrics 38 (1982) 963). B and W are shrunk to what the classes have in
common by inverse Wishart priors worth a few specimens, that to a default spread by one more. What
the library holds is the prediction for a new contact with a new specimen: Student's t about
:math:`\mu` with scale matrix B + W + Var(:math:`\mu`), and degrees of freedom from the specimens.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.stats import beta

from fden_ros.core.arrays import Array
from fden_ros.core.classification import (
    UNKNOWN,
    Likelihood,
    Tissue,
    TissueLibrary,
    likelihood_of,
    log_evidence,
    posterior,
)
from fden_ros.core.estimation import Prior
from fden_ros.errors import InputError
from fden_ros.tissues.library import FORMAT, parse_library

#: The prior of what classes have in common is worth 4 specimens.
SHRINKAGE = 4.0
#: Spread between specimens where nothing is known: of the paper's liver, alpha wider.
_DEFAULT_SPREAD = np.diag(np.square([0.28, 0.19, 0.02]))
_DEFAULT_WEIGHT = 1.0
#: Within a specimen a quarter of the variance between.
_DEFAULT_WITHIN = 0.25 * _DEFAULT_SPREAD
#: Where a class may lie at all: a prior so wide that it only helps where a direction is unseen.
_WIDE_SPREAD = np.diag(np.square([3.0, 1.0, 0.2]))
#: Spread of the unknown about the classes: as wide as soft tissue is (a factor of 4 in G).
_UNKNOWN_SPREAD = np.diag(np.square([1.4, 0.6, 0.12]))
UNKNOWN_PRIOR = 0.1
_ITERATIONS, _MORE_ITERATIONS, _TOLERANCE = 500, 60, 1e-5
_LEAST_VARIANCE = np.array([1e-6, 1e-6, 1e-8])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Labelled contacts.

    Parameters
    ----------
    tissues : tuple of str
        Class of each, (n,).
    specimens : tuple of str
        Specimen of each, within its class; empty where it is not named, (n,).
    likelihood : Likelihood
        Of all, leading axis n.
    sources : tuple of str
        Where they come from.
    mismatched : int
        How many were flagged as not described by the model.
    skipped : dict
        Contacts that could not be used, by reason.
    """

    tissues: tuple[str, ...]
    specimens: tuple[str, ...]
    likelihood: Likelihood
    sources: tuple[str, ...] = ()
    mismatched: int = 0
    skipped: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.tissues)

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes, sorted."""
        return tuple(sorted(set(self.tissues)))

    @property
    def groups(self) -> tuple[tuple[str, str], ...]:
        """Class and specimen of each contact; a specimen of its own where none is named."""
        own = (name or f"contact {number}" for number, name in enumerate(self.specimens, start=1))
        return tuple(zip(self.tissues, own, strict=True))

    @property
    def unnamed(self) -> tuple[str, ...]:
        """Classes with contacts whose specimen is not named."""
        pairs = zip(self.tissues, self.specimens, strict=True)
        return tuple(sorted({tissue for tissue, specimen in pairs if not specimen}))

    def only(self, keep: Iterable[int]) -> Contacts:
        """Return some of them, by index."""
        index = np.array(list(keep), dtype=np.intp)
        one = self.likelihood
        groups = self.groups
        return Contacts(
            tuple(self.tissues[i] for i in index),
            tuple(groups[i][1] for i in index),
            Likelihood(one.centre[index], one.score[index], one.information[index]),
        )


def joined(parts: Sequence[Contacts]) -> Contacts:
    """Return the contacts of several sources as one.

    Raises
    ------
    InputError
        If there are none.
    """
    skipped: Counter[str] = Counter()
    for part in parts:
        skipped.update(part.skipped)
    full = [part for part in parts if len(part)]
    if not full:
        reasons = ", ".join(f"{count} {reason}" for reason, count in skipped.items())
        raise InputError(
            f"no contact to learn from{f' ({reasons})' if reasons else ''}; give contacts with "
            "a converged estimate"
        )
    return Contacts(
        sum((part.tissues for part in full), ()),
        sum((part.specimens for part in full), ()),
        Likelihood(
            np.concatenate([part.likelihood.centre for part in full]),
            np.concatenate([part.likelihood.score for part in full]),
            np.concatenate([part.likelihood.information for part in full]),
        ),
        sum((part.sources for part in parts), ()),
        sum(part.mismatched for part in parts),
        skipped,
    )


@dataclass(frozen=True, eq=False)
class Spread:
    """One class as learned."""

    mean: Array  #: mu, shape (3,)
    between: Array  #: B, shape (3, 3)
    within: Array  #: W, shape (3, 3)
    mean_covariance: Array  #: of mu, shape (3, 3)
    contacts: int
    specimens: int

    def tissue(self, name: str, prior: float = 1.0) -> Tissue:
        """Return the prediction for a new contact with a new specimen."""
        scale = self.between + self.within + self.mean_covariance
        return Tissue(
            name,
            self.mean,
            0.5 * (scale + scale.T),
            prior,
            max(self.specimens - 1.0 + SHRINKAGE, 1.0),
        )


class _Specimens:
    """The contacts of one class, with their specimens by number."""

    def __init__(self, likelihood: Likelihood, specimen: NDArray[np.intp]) -> None:
        self.information = likelihood.information
        #: Lambda z, which exists where z does not
        self.pull = likelihood.score + np.einsum(
            "nij,nj->ni", likelihood.information, likelihood.centre
        )
        self.specimen = specimen
        self.count = int(specimen.max()) + 1
        self.has_repeats = self.count < len(specimen)


def learn(contacts: Contacts, start: Mapping[str, Spread] | None = None) -> dict[str, Spread]:
    """Return the spread of every class.

    Parameters
    ----------
    contacts : Contacts
    start : mapping, optional
        Spreads to start from, which saves time where little has changed.
    """
    groups = np.array([f"{tissue}\0{specimen}" for tissue, specimen in contacts.groups])
    tissues = np.array(contacts.tissues)
    centre = _centre(contacts.likelihood)
    data = {}
    for name in contacts.classes:
        own = np.flatnonzero(tissues == name)
        one = contacts.likelihood
        likelihood = Likelihood(one.centre[own], one.score[own], one.information[own])
        data[name] = _Specimens(likelihood, np.unique(groups[own], return_inverse=True)[1])
    spreads = {
        name: start[name]
        if start is not None and name in start
        else Spread(centre, _DEFAULT_SPREAD, _DEFAULT_WITHIN, _WIDE_SPREAD, 0, 0)
        for name in data
    }
    has_repeats = any(own.has_repeats for own in data.values())
    if not has_repeats:
        # Then what varies within a specimen cannot be told from what varies between.
        spreads = {
            name: replace(spread, within=np.zeros((3, 3))) for name, spread in spreads.items()
        }
    for _ in range(_ITERATIONS if start is None else _MORE_ITERATIONS):
        moments = {name: _expect(data[name], spreads[name], centre) for name in data}
        common = _common(moments, data, has_repeats)
        newer = {name: _maximise(data[name], moments[name], common, has_repeats) for name in data}
        change = max(
            float(np.max(np.abs(newer[name].between - spreads[name].between) / _scale(common[0])))
            for name in data
        )
        spreads = newer
        if change < _TOLERANCE:
            break
    return spreads


def _centre(likelihood: Likelihood) -> Array:
    """Return where contacts lie on the whole, each direction by those that saw it."""
    information = likelihood.information / (
        1.0 + np.einsum("nii->n", likelihood.information)[:, None, None]
    )
    pull = np.einsum("nij,nj->ni", information, likelihood.centre)
    ridge = 1e-9 * np.eye(3)
    result: Array = np.linalg.solve(
        information.sum(axis=0) + ridge, pull.sum(axis=0) + ridge @ likelihood.centre.mean(axis=0)
    )
    return result


def _scale(covariance: Array) -> Array:
    deviations = np.sqrt(np.diag(covariance))
    return np.outer(deviations, deviations)


@dataclass(frozen=True, eq=False)
class _Moments:
    mean: Array
    mean_covariance: Array
    between: Array  #: sum of E[b b']
    within: Array  #: sum of E[w w']


def _expect(data: _Specimens, spread: Spread, centre: Array) -> _Moments:
    eye, between, within = np.eye(3), spread.between, spread.within
    # (W + Lambda^-1)^-1 and that times z, where Lambda need not be invertible.
    inner = np.linalg.solve(
        eye + data.information @ within,
        np.concatenate([data.information, data.pull[..., None]], axis=-1),
    )
    seen, pull = inner[..., :3], inner[..., 3]
    by_specimen = np.zeros((data.count, 3, 3))
    pulls = np.zeros((data.count, 3))
    np.add.at(by_specimen, data.specimen, seen)
    np.add.at(pulls, data.specimen, pull)
    outer = np.linalg.solve(
        eye + by_specimen @ between, np.concatenate([by_specimen, pulls[..., None]], axis=-1)
    )
    about, towards = outer[..., :3], outer[..., 3]
    wide = np.linalg.inv(_WIDE_SPREAD)
    mean_covariance = np.linalg.inv(about.sum(axis=0) + wide)
    mean = mean_covariance @ (towards.sum(axis=0) + wide @ centre)

    gain = between @ about
    own = np.einsum("ij,sj->si", between, towards - about @ mean)
    own_covariance = between - gain @ between
    spill = gain @ mean_covariance @ np.swapaxes(gain, -1, -2)
    between_sum = np.einsum("si,sj->ij", own, own) + (own_covariance + spill).sum(axis=0)

    left = eye - gain
    place_covariance = own_covariance + left @ mean_covariance @ np.swapaxes(left, -1, -2)
    place = (mean + own)[data.specimen]
    inside = np.einsum("ij,nj->ni", within, pull - np.einsum("nij,nj->ni", seen, place))
    back = within @ seen
    inside_covariance = (
        within - back @ within + back @ place_covariance[data.specimen] @ np.swapaxes(back, -1, -2)
    )
    within_sum = np.einsum("ni,nj->ij", inside, inside) + inside_covariance.sum(axis=0)
    return _Moments(mean, mean_covariance, between_sum, within_sum)


def _common(
    moments: Mapping[str, _Moments], data: Mapping[str, _Specimens], has_repeats: bool
) -> tuple[Array, Array]:
    """Return what the classes have in common: B and W."""
    specimens = sum(own.count for own in data.values())
    contacts = sum(own.specimen.size for own in data.values())
    between = sum((m.between for m in moments.values()), _DEFAULT_WEIGHT * _DEFAULT_SPREAD)
    within = sum((m.within for m in moments.values()), _DEFAULT_WEIGHT * _DEFAULT_WITHIN)
    if not has_repeats:
        within = np.zeros((3, 3))
    return between / (specimens + _DEFAULT_WEIGHT), within / (contacts + _DEFAULT_WEIGHT)


def _maximise(
    data: _Specimens,
    moments: _Moments,
    common: tuple[Array, Array],
    has_repeats: bool,
) -> Spread:
    between = (moments.between + SHRINKAGE * common[0]) / (data.count + SHRINKAGE)
    within = (moments.within + SHRINKAGE * common[1]) / (data.specimen.size + SHRINKAGE)
    between = 0.5 * (between + between.T) + np.diag(_LEAST_VARIANCE)
    within = 0.5 * (within + within.T)
    if has_repeats:
        within += np.diag(_LEAST_VARIANCE)
    return Spread(
        moments.mean,
        between,
        within,
        moments.mean_covariance,
        int(data.specimen.size),
        data.count,
    )


def library_of(
    spreads: Mapping[str, Spread],
    name: str = "learned",
    priors: Mapping[str, float] | None = None,
    unknown_prior: float = UNKNOWN_PRIOR,
    units: str = "Pa",
    geometry: str = "",
) -> TissueLibrary:
    """Return the library of learned classes, and the unknown about them.

    Parameters
    ----------
    spreads : mapping
        As :func:`learn` returns them.
    name, units, geometry
        As in :class:`~fden_ros.core.classification.classifier.TissueLibrary`.
    priors : mapping, optional
        Up to a common factor; all alike where not given.
    unknown_prior : float
        Probability of what is none of them.
    """
    given = {tissue: (priors or {}).get(tissue, 1.0) for tissue in spreads}
    known = (1.0 - unknown_prior) / sum(given.values())
    tissues = tuple(
        spread.tissue(tissue, given[tissue] * known) for tissue, spread in spreads.items()
    )
    means = np.array([spread.mean for spread in spreads.values()])
    about = means - means.mean(axis=0)
    wide = _UNKNOWN_SPREAD + about.T @ about / len(means)
    unknown = Tissue(UNKNOWN, means.mean(axis=0), wide, unknown_prior)
    return TissueLibrary(name, tissues, unknown, units, geometry)


# The check


@dataclass(frozen=True, eq=False)
class Check:
    """What came out where the specimen of each contact had been left out.

    Parameters
    ----------
    names : tuple of str
        Classes, ``unknown`` last.
    truth : ndarray of int, shape (n,)
    probabilities : ndarray, shape (n, k + 1)
    p_value : ndarray, shape (n,)
    groups : tuple of (str, str), shape (n,)
        Class and specimen.
    unchecked : tuple of str
        Classes with a single specimen, which cannot be left out.
    unnamed : tuple of str
        Classes that name no specimen: there each contact was left out alone.
    """

    names: tuple[str, ...]
    truth: NDArray[np.intp]
    probabilities: Array
    p_value: Array
    groups: tuple[tuple[str, str], ...]
    unchecked: tuple[str, ...]
    unnamed: tuple[str, ...]

    @property
    def errors(self) -> NDArray[np.bool_]:
        """Where the most probable tissue is not the true one, shape (n,)."""
        result: NDArray[np.bool_] = self.probabilities[:, :-1].argmax(axis=1) != self.truth
        return result

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Where the most probable answer is ``unknown``, shape (n,)."""
        result: NDArray[np.bool_] = self.probabilities.argmax(axis=1) == len(self.names) - 1
        return result

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the error rate, specimens counted, not contacts."""
        return share_interval(self.errors, [f"{t}\0{s}" for t, s in self.groups])

    def confusion(self) -> NDArray[np.intp]:
        """Return how often each class (row) got each answer (column), ``unknown`` last."""
        count = len(self.names)
        table = np.zeros((count - 1, count), dtype=np.intp)
        np.add.at(table, (self.truth, self.probabilities.argmax(axis=1)), 1)
        return table


def share_interval(hits: NDArray[np.bool_], groups: Sequence[str]) -> tuple[float, float]:
    """Return the 95 % interval of a rate, for hits that come in groups.

    Clopper and Pearson's, with the contacts divided by the design effect; where all answers are
    alike that cannot be seen, and each group counts once.
    """
    rate, total = float(np.mean(hits)), len(hits)
    names, index = np.unique(np.array(groups), return_inverse=True)
    count = len(names)
    effective = float(count)
    if 0.0 < rate < 1.0 and count > 1:
        sums = np.bincount(index, weights=hits - rate, minlength=count)
        variance = count / (count - 1.0) * float(sums @ sums) / total**2
        effective = min(max(rate * (1.0 - rate) / max(variance, 1e-12), 1.0), float(total))
    own = rate * effective
    low = 0.0 if own == 0.0 else float(beta.ppf(0.025, own, effective - own + 1.0))
    high = 1.0 if rate == 1.0 else float(beta.ppf(0.975, own + 1.0, effective - own))
    return low, high


def check(
    contacts: Contacts,
    spreads: Mapping[str, Spread],
    make: Callable[[Mapping[str, Spread]], TissueLibrary] = library_of,
    show: Callable[[float], None] = lambda done: None,
) -> Check:
    """Leave out one specimen at a time, learn from the others, and classify its contacts.

    Parameters
    ----------
    contacts : Contacts
    spreads : mapping
        Learned from all of them: where to start from.
    make : callable
        The library of spreads.
    show : callable
        Called after each specimen with how many are done.
    """
    groups = contacts.groups
    folds = np.array(["\0".join(group) for group in groups])
    tissues = np.array(contacts.tissues)
    names = contacts.classes
    unchecked = tuple(name for name in names if len(set(folds[tissues == name])) < 2)
    used = np.flatnonzero(~np.isin(tissues, unchecked))
    probabilities = np.full((len(contacts), len(names) + 1), np.nan)
    p_value = np.full(len(contacts), np.nan)
    for done, one in enumerate(np.unique(folds[used]), start=1):
        out = folds == one
        library = make(learn(contacts.only(np.flatnonzero(~out)), spreads))
        left = contacts.only(np.flatnonzero(out)).likelihood
        evidence, fits = log_evidence(library, left)
        probabilities[out] = posterior(library, evidence)
        p_value[out] = fits.max(axis=-1)
        show(done)
    return Check(
        (*names, UNKNOWN),
        np.searchsorted(np.array(names), tissues[used]),
        probabilities[used],
        p_value[used],
        tuple(groups[i] for i in used),
        unchecked,
        contacts.unnamed,
    )


# The file


def library_text(
    library: TissueLibrary,
    spreads: Mapping[str, Spread],
    contacts: Contacts,
    result: Check,
    geometry: Mapping[str, Any],
) -> str:
    """Return the library as YAML, with what it was learned from and its check."""
    content: dict[str, Any] = {"format": FORMAT, "name": library.name, "units": library.units}
    if geometry:
        content["geometry"] = dict(geometry)
    content["trained_on"] = {
        "sources": list(contacts.sources),
        "contacts": len(contacts),
        "mismatched": contacts.mismatched,
        "left_out": dict(contacts.skipped),
    }
    content["check"] = check_object(result)
    content["tissues"] = [
        _entry(tissue)
        | {
            "trained_on": {
                "contacts": spreads[tissue.name].contacts,
                "specimens": spreads[tissue.name].specimens
                if tissue.name not in contacts.unnamed
                else None,
            },
            "within_specimens": _rounded(spreads[tissue.name].within),
        }
        for tissue in library.tissues
    ]
    content["unknown"] = {
        key: value for key, value in _entry(library.unknown).items() if key != "name"
    }
    text = _HEAD.format(unit=library.units) + yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, width=96, allow_unicode=True
    )
    parse_library(text, "the learned library")
    return text


_HEAD = """\
# Tissue library, learned by `fden train`. The distribution is that of (ln G, ln Gn, alpha) over
# contacts with new specimens, G in {unit} s^alpha. `prior` may be changed: the probability of
# meeting a tissue, up to a common factor. docs/classification.md explains the rest.
"""


def _entry(tissue: Tissue) -> dict[str, Any]:
    spread = np.sqrt(np.diag(tissue.covariance))
    entry: dict[str, Any] = {
        "name": tissue.name,
        "prior": round(tissue.prior, 6),
        "median": {
            "linear_stiffness": _digits(math.exp(tissue.mean[0])),
            "nonlinear_stiffness": _digits(math.exp(tissue.mean[1])),
            "fractional_order": _digits(float(tissue.mean[2])),
        },
        "spread": {
            "log_linear_stiffness": _digits(spread[0]),
            "log_nonlinear_stiffness": _digits(spread[1]),
            "fractional_order": _digits(spread[2]),
        },
        "distribution": {
            "mean": _rounded(tissue.mean),
            "covariance": _rounded(tissue.covariance),
        },
    }
    if math.isfinite(tissue.degrees_of_freedom):
        entry["distribution"]["degrees_of_freedom"] = tissue.degrees_of_freedom
    return entry


def _rounded(values: Array) -> Any:
    return np.vectorize(lambda value: float(f"{value:.10g}"))(values).tolist()


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def check_object(result: Check) -> dict[str, Any]:
    """Return a check, ready for YAML and JSON."""
    if not len(result.truth):
        return {"left_out": "nothing", "unchecked": list(result.unchecked)}
    low, high = result.interval()
    confusion = result.confusion()
    return {
        "left_out": "one contact at a time: no specimen is named"
        if result.unnamed and set(result.unnamed) >= {t for t, _ in result.groups}
        else "one specimen at a time",
        "specimens": len(set(result.groups)),
        "contacts": len(result.truth),
        "error": _digits(float(np.mean(result.errors))),
        "error_95": [_digits(low), _digits(high)],
        "called_unknown": _digits(float(np.mean(result.unknown))),
        "confusion": {
            name: dict(zip(result.names, row.tolist(), strict=True))
            for name, row in zip(result.names[:-1], confusion, strict=True)
            if row.sum()
        },
        "unchecked": list(result.unchecked),
        "without_named_specimens": list(result.unnamed),
    }


def contacts_of(
    tissues: Sequence[str],
    specimens: Sequence[str],
    means: Array,
    covariances: Array,
    prior: Prior | None = None,
    order_counts: Sequence[bool] | None = None,
    **other: Any,
) -> Contacts:
    """Return labelled contacts from posteriors.

    Parameters
    ----------
    tissues, specimens : sequence of str
    means : ndarray, shape (n, 3)
        (ln G, ln Gn, alpha).
    covariances : ndarray, shape (n, 3, 3)
    prior : Prior, optional
        The estimator's; None: measurements that no prior went into.
    order_counts : sequence of bool, optional
        alpha was learned or measured.
    **other
        The other fields of :class:`Contacts`.
    """
    counts = np.ones(len(means), dtype=bool) if order_counts is None else np.array(order_counts)
    whole = likelihood_of(means, covariances, prior)
    without = likelihood_of(means, covariances, prior, order_counts=False)
    return Contacts(
        tuple(tissues),
        tuple(specimens),
        Likelihood(
            means,
            np.where(counts[:, None], whole.score, without.score),
            np.where(counts[:, None, None], whole.information, without.information),
        ),
        **other,
    )
