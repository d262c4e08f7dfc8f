# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The surface's normal from first touches: intervals that hold, and touches that show no plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fden_ros.configure.plane import NoPlaneError, SurfacePlane, fit_plane

Array = np.ndarray
SIZE = 0.02  #: touches within this of the middle, to each side [m]


def touches(seed: int, count: int, *, noise: float, curvature: float = 0.0) -> tuple[Array, Array]:
    """Return places (n, 3) on a surface that lies anyhow, and its normal into the tissue (3,).

    They scatter by `noise` [m] along the normal and by 20 um beside it; the surface is a
    paraboloid of that `curvature` [1/m].
    """
    draw = np.random.default_rng([seed, count])
    turn = Rotation.random(random_state=seed).as_matrix()
    aside = draw.uniform(-SIZE, SIZE, (count, 2))
    depth = 0.5 * curvature * np.sum(aside**2, axis=1) + draw.normal(0.0, noise, count)
    places = np.column_stack([aside + draw.normal(0.0, 2e-5, aside.shape), depth])
    return places @ turn.T + draw.uniform(-0.5, 0.5, 3), turn[:, 2]


def into(normal: Array, seed: int) -> Array:
    """A probe that stands within some 20 degrees of upright."""
    return np.asarray(normal + np.random.default_rng(seed).normal(0.0, 0.2, 3))


def errors(plane: SurfacePlane, normal: Array) -> Array:
    """Return the error of both tilts over their deviations (2,)."""
    variances, directions = np.linalg.eigh(plane.covariance)
    return ((plane.normal - normal) @ directions[:, 1:]) / np.sqrt(variances[1:])


@pytest.mark.parametrize(
    ("count", "noise", "stated"),
    [
        (3, 5e-5, 5e-5),
        (4, 5e-5, 5e-5),
        (6, 1e-4, 1e-4),
        (6, 1e-4, 0.0),  # not stated
        (10, 1e-4, 0.0),
        (10, 2e-4, 5e-5),  # stated, but the surface is uneven
        (30, 2e-4, 1e-4),
    ],
)
def test_the_intervals_of_the_angle_hold(count: int, noise: float, stated: float) -> None:
    found = []
    for seed in range(200):
        places, normal = touches(seed, count, noise=noise)
        try:
            plane = fit_plane(places, into(normal, seed), stated)
        except NoPlaneError:
            continue
        found.append(errors(plane, normal))
    assert len(found) > 100
    assert 0.9 <= np.mean(np.abs(found) < 1.96) <= 0.99


def refusal(places: Array, normal: Array, sds: float = 1e-4) -> str:
    with pytest.raises(NoPlaneError) as caught:
        fit_plane(places, normal, sds)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_too_few_touches_are_refused() -> None:
    places, normal = touches(1, 4, noise=1e-5)
    assert "3 places or more" in refusal(places[:2], normal)
    assert "5 places or more" in refusal(places, normal, 0.0)
    assert "0 touches" in refusal(np.empty((0, 3)), normal)


def test_touches_on_one_line_are_refused_however_exact() -> None:
    places, normal = touches(2, 8, noise=1e-6)
    aside = np.cross(normal, [1.0, 0.0, 0.0])
    on_line = places - np.outer((places - places.mean(axis=0)) @ aside, aside) / (aside @ aside)
    assert "one line, within" in (words := refusal(on_line, normal, 1e-6))
    assert "mm aside of it" in words


@pytest.mark.parametrize("stated", [0.0, 1e-4])
def test_a_curved_surface_is_refused(stated: float) -> None:
    """A radius of 50 mm: at 20 mm from the middle it slopes by 22 degrees."""
    for seed in range(100):
        places, normal = touches(seed, 12, noise=1e-4, curvature=20.0)
        assert "the surface is curved or moves: touch within" in refusal(places, normal, stated)


def test_the_tilt_of_a_probe_is_told_with_its_deviation() -> None:
    places, normal = touches(4, 20, noise=1e-5)
    plane = fit_plane(places, normal, 1e-5)
    across = np.cross(normal, [1.0, 0.0, 0.0])
    askew = Rotation.from_rotvec(math.radians(20.0) * across / np.linalg.norm(across))
    tilt, sd = plane.tilt(askew.apply(normal))
    assert abs(tilt - math.radians(20.0)) < 4.0 * sd < math.radians(0.2)
