# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Measured beef and silicone told apart: FDEN's parameters, and those of other contact models."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.benchmarks.measured_tests import Test
from fden_ros.benchmarks.peers import DiolaitiHuntCrossley, HaddadiHuntCrossley, KelvinVoigt
from fden_ros.benchmarks.real import _WIDE, identify
from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import Likelihood, likelihood_of
from fden_ros.core.outputs import Flag
from fden_ros.experiments.indentation import fit_indentation
from fden_ros.tissues.training import Check, Contacts, check, contacts_of, learn

#: Spread that the classifier of FDEN's parameters takes for usual: others are scaled to it.
_USUAL = np.array([0.28, 0.19, 0.02])
_LEAST_DEVIATION = 0.05
_REFERENCE_STRAIN = 0.1

ONLINE, FDEN, KELVIN_VOIGT, DIOLAITI, HADDADI = (
    "FDEN, online",
    "FDEN, fitted afterwards",
    "Kelvin-Voigt",
    "Hunt-Crossley, Diolaiti",
    "Hunt-Crossley, Haddadi",
)


@dataclass(frozen=True, eq=False)
class Told:
    """What one set of parameters tells."""

    kinds: Check  #: beef or silicone
    cuts: Check | None  #: the cuts of beef
    mismatched: int
    contacts: Contacts


def specimen_of(test: Test) -> str:
    """Return the piece of material: that of a numbered series of tests is one."""
    name = test.specimen
    head, _, number = name.rpartition("-")
    return head if head and number.isdigit() else name


def tell(tests: Sequence[Test], advance: Callable[[], None]) -> dict[str, Told]:
    """Return what each model's parameters tell, by its name."""
    means, covariances, mismatched = [], [], 0
    for test in tests:
        estimate, state = identify(test, _WIDE, test.times.size)
        means.append(estimate.mean)
        covariances.append(estimate.covariance)
        mismatched += Flag.MODEL_MISMATCH in state.flags
        advance()
    fden = contacts_of(
        [test.kind for test in tests],
        [specimen_of(test) for test in tests],
        np.array(means),
        np.array(covariances),
        _WIDE,
        mismatched=mismatched,
    )
    told = {ONLINE: _told(tests, fden)}
    told[FDEN] = _told(tests, _fitted(tests))
    advance()
    for name, features in (
        (KELVIN_VOIGT, _kelvin_voigt),
        (DIOLAITI, _diolaiti),
        (HADDADI, _haddadi),
    ):
        told[name] = _told(tests, _as_contacts(tests, np.array([features(t) for t in tests])))
        advance()
    return told


def _fitted(tests: Sequence[Test]) -> Contacts:
    """Return what ``fden fit indentation`` makes of each whole test."""
    means, covariances = [], []
    for test in tests:
        strains = np.maximum(test.displacements, 0.0) / test.thickness
        strains[0] = 0.0
        fit = fit_indentation(test.times, strains, test.forces)
        g, g_n, order = fit["g"], fit["g_n"], fit["alpha"]
        means.append([math.log(g.value), math.log(g_n.value), order.value])
        covariances.append(np.diag(np.square([g.sd / g.value, g_n.sd / g_n.value, order.sd])))
    return contacts_of(
        [test.kind for test in tests],
        [specimen_of(test) for test in tests],
        np.array(means),
        np.array(covariances),
    )


# The others: parameters over strain, so that thickness counts as for FDEN


def _kelvin_voigt(test: Test) -> list[float]:
    peer = KelvinVoigt()
    peer.learn(test.times, test.displacements / test.thickness, test.forces)
    stiffness, damping = peer.coefficients
    return [math.log(max(float(stiffness), 1e-6)), float(damping / stiffness), math.nan]


def _diolaiti(test: Test) -> list[float]:
    peer = DiolaitiHuntCrossley()
    peer.learn(test.times, test.displacements / test.thickness, test.forces)
    stiffness, damping = peer.coefficients
    force = max(float(stiffness), 1e-9) * _REFERENCE_STRAIN**peer.exponent
    return [math.log(force), peer.exponent, float(damping / stiffness)]


def _haddadi(test: Test) -> list[float]:
    peer = HaddadiHuntCrossley()
    peer.learn(test.times, test.displacements / test.thickness, test.forces)
    log_stiffness, damping, exponent = (float(v) for v in peer.coefficients)
    return [log_stiffness + exponent * math.log(_REFERENCE_STRAIN), exponent, damping]


def _as_contacts(tests: Sequence[Test], features: Array) -> Contacts:
    """Return features as contacts without estimation error, scaled to the usual spread."""
    materials = np.array([test.material for test in tests])
    missing = np.all(np.isnan(features), axis=0)
    features = np.where(missing, 0.0, features)
    # Robust: an estimator that runs away must not hide the others.
    inside = features.copy()
    for name in set(materials):
        inside[materials == name] -= np.median(features[materials == name], axis=0)
    scale = 1.4826 * np.median(np.abs(inside), axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = (features - np.median(features, axis=0)) / scale * _USUAL
    scaled += np.array([math.log(500.0), math.log(8.0), 0.2])
    covariance = np.diag(np.square(_LEAST_DEVIATION * _USUAL))
    whole = likelihood_of(scaled, np.broadcast_to(covariance, (len(tests), 3, 3)))
    information = whole.information * ~missing[:, None] * ~missing
    return Contacts(
        tuple(test.kind for test in tests),
        tuple(specimen_of(test) for test in tests),
        Likelihood(whole.centre, whole.score, information),
    )


def _told(tests: Sequence[Test], contacts: Contacts) -> Told:
    kinds = _checked(contacts, [test.kind for test in tests])
    beef = [i for i, test in enumerate(tests) if test.material != test.kind]
    cuts = None
    if beef:
        cuts = _checked(contacts.only(beef), [tests[i].material for i in beef])
    return Told(kinds, cuts, contacts.mismatched, contacts)


def _checked(contacts: Contacts, labels: Sequence[str]) -> Check:
    """Leave out one specimen at a time; where a class has one only, one test at a time."""
    groups = contacts.groups
    pieces = {
        label: {g[1] for g, own in zip(groups, labels, strict=True) if own == label}
        for label in labels
    }
    specimens = [
        specimen if len(pieces[label]) > 1 else f"{specimen}, test {index}"
        for index, ((_, specimen), label) in enumerate(zip(groups, labels, strict=True))
    ]
    own = Contacts(tuple(labels), tuple(specimens), contacts.likelihood)
    spreads = learn(own)
    return check(own, spreads)
