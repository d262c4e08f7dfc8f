# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The constitutive law: smooth at the boundary strain, odd, and what its derivatives say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from scipy.special import gamma

from fden_ros.core.law.characteristic import (
    apparent_stiffness_factor,
    elastic_response,
    log_phi,
    log_strain,
    phi,
    strain_of_phi,
)

#: No test depends on the time it takes, nor on chance.
steady = examples(100)

stiffnesses = st.floats(1.0, 1e5)
nonlinear_stiffnesses = st.floats(0.5, 50.0)
strains = st.floats(-1.0, 1.0)


@steady
@given(x=st.floats(0.0, 1.0), G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_value_is_the_paper_s_two_branches(x, G, Gn):
    expected = G * x if x <= 1.0 / Gn else G / Gn * math.exp(Gn * x - 1.0)
    assert elastic_response(x, G, Gn).value == pytest.approx(expected, rel=1e-12)


@steady
@given(x=strains, G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_derivatives_are_those_of_the_value(x, G, Gn):
    response = elastic_response(x, G, Gn)
    step = 1e-6

    def central(plus, minus):
        return (plus.value - minus.value) / (2.0 * step)

    # Central differences err by step^2 f'''/6, below 1e-12 Gn^3 of the value's scale; rounding by
    # 1e-16 / 1e-6. At the boundary the second derivative jumps: step G Gn / 2 more.
    scale = G * math.exp(max(Gn * abs(x) - 1.0, 0.0))
    by_strain = central(elastic_response(x + step, G, Gn), elastic_response(x - step, G, Gn))
    assert by_strain == pytest.approx(response.by_strain, abs=1e-4 * scale)
    up, down = Gn * math.exp(step), Gn * math.exp(-step)
    by_log_gn = central(elastic_response(x, G, up), elastic_response(x, G, down))
    assert by_log_gn == pytest.approx(response.by_log_nonlinear_stiffness, abs=1e-4 * scale)
    by_log_g = central(
        elastic_response(x, G * math.exp(step), Gn), elastic_response(x, G * math.exp(-step), Gn)
    )
    assert by_log_g == pytest.approx(response.value, rel=1e-8, abs=1e-9)


@steady
@given(x=strains, G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_the_inverses_give_the_strain_back(x, G, Gn):
    found = strain_of_phi(phi(np.array([x]), G, Gn), G, Gn)
    assert found == pytest.approx([x], rel=1e-9, abs=1e-12)
    logs = math.log(G), math.log(Gn)
    log_x = np.log(np.array([abs(x) + 1e-6]))
    assert log_strain(log_phi(np.exp(log_x), *logs), *logs) == pytest.approx(log_x, abs=1e-9)


def test_apparent_stiffness_is_the_relaxation_of_a_step():
    # A step of strain held for tau: stress G x tau^-alpha / Gamma(1 - alpha), the corrected E1.
    assert apparent_stiffness_factor(0.32, 0.1) == pytest.approx(0.1**-0.32 / gamma(0.68))
    # The design's example: from 1 ms to 1 s it changes 2.4 times at 0.125, 9 times at 0.32.
    for order, ratio in ((0.125, 2.37), (0.32, 9.12)):
        change = apparent_stiffness_factor(order, 1e-3) / apparent_stiffness_factor(order, 1.0)
        assert change == pytest.approx(ratio, rel=0.01)
