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

"""Ladders of springs and dashpots: a second truth, that shares nothing with the springpot."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.special import gamma

from fden_ros.errors import InputError
from fden_ros.experiments.indentation import fit_indentation
from fden_ros.simulation.ladder import Ladder, contact_stress

ORDERS = {1: 1e-5, 2: 2e-3, 3: 0.03}


@pytest.mark.parametrize("rungs", [1, 2, 7])
def test_modulus_of_few_rungs_is_that_of_springs_and_dashpots_one_by_one(rungs):
    s = 0.3 + 0.2j

    def ladder(dashpot):
        modulus = 0.0
        for _ in range(rungs):
            modulus = 1.0 / (1.0 + 1.0 / (dashpot + modulus))
        return modulus

    assert complex(Ladder(1, 1.0, 1.0, rungs).modulus(s)) == pytest.approx(ladder(s))
    assert complex(Ladder(2, 1.0, 1.0, rungs).modulus(s)) == pytest.approx(ladder(ladder(s)))


@pytest.mark.parametrize("levels", ORDERS)
def test_impedance_and_creep_approach_the_springpot_over_two_decades(levels):
    ladder = Ladder.like_springpot(levels, 545.0, 1e-12)
    alpha = ladder.fractional_order
    omegas, times = np.geomspace(1.0, 100.0, 9), np.geomspace(0.05, 5.0, 9)
    modulus = ladder.modulus(1j * omegas) / (545.0 * (1j * omegas) ** alpha)
    creep = ladder.creep(times) * 545.0 * gamma(1.0 + alpha) / times**alpha
    relaxation = ladder.relaxation(times) / (545.0 * times**-alpha / gamma(1.0 - alpha))
    for ratio in (modulus, creep, relaxation):
        assert np.abs(ratio - 1.0).max() < ORDERS[levels]


def test_order_one_eighth_fades_in_slowly_with_depth():
    omegas = np.geomspace(0.1, 10.0, 9)
    errors = {}
    for tau in (1e-6, 1e-9, 1e-12):
        modulus = np.abs(Ladder.like_springpot(3, 1.0, tau).modulus(1j * omegas))
        errors[tau] = abs(np.polyfit(np.log(omegas), np.log(modulus), 1)[0] - 0.125)
    assert errors[1e-6] > 0.005 >= errors[1e-9] > errors[1e-12]


def test_response_over_time_is_that_of_a_long_double_inversion():
    ladder = Ladder(1, 2.0, 0.5, 3)

    def transform(s):
        modulus = mpmath.mpf(0)
        for _ in range(3):
            modulus = 1 / (1 + 1 / (s * mpmath.mpf(0.5) + modulus))
        return 1 / (s * 2 * modulus)

    times = [0.1, 1.0, 10.0]
    exact = [float(mpmath.invertlaplace(transform, t, method="talbot")) for t in times]
    assert ladder.creep(times) == pytest.approx(exact, rel=1e-7)


def test_contact_with_the_one_eighth_ladder_is_identified_as_one_eighth():
    time = np.linspace(0.0, 5.0, 251)
    strain = 0.25 * np.minimum(time, 1.0)
    ladder = Ladder.like_springpot(3, 545.0, 1e-12)
    fit = fit_indentation(time, strain, contact_stress(ladder, 8.55, time, strain))
    assert fit["alpha"].value == pytest.approx(0.125, abs=0.005)
    assert fit["g"].value == pytest.approx(545.0, rel=0.03)
    assert fit["g_n"].value == pytest.approx(8.55, rel=0.005)


def test_impossible_ladders_are_refused():
    with pytest.raises(InputError, match="one rung"):
        Ladder(1, 1.0, 1.0, 0)
    with pytest.raises(InputError, match="positive"):
        Ladder(1, -1.0, 1.0)
    with pytest.raises(InputError, match="even steps"):
        contact_stress(Ladder(1, 1.0, 1.0), 8.0, np.array([0.0, 1.0, 3.0]), np.zeros(3))
