# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The table of experiments: what the file of each holds, what it gives, and where its fit is."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.experiments.result import Fit


@dataclass(frozen=True)
class Options:
    """What a file does not say itself.

    Parameters
    ----------
    stress : float, optional
        Constant stress of a creep test [Pa].
    strain : float, optional
        Constant strain of a relaxation test [1].
    start : float, optional
        Rows before this time [s] are left out; None: 1 s for creep, else nothing.
    alpha, alpha_sd : float
        Fractional order from elsewhere, and its deviation.
    """

    stress: float | None = None
    strain: float | None = None
    start: float | None = None
    alpha: float | None = None
    alpha_sd: float = 0.0


@dataclass(frozen=True)
class Experiment:
    """One kind of experiment.

    Parameters
    ----------
    files : tuple of (str, str)
        The columns of each kind of file, and what is found from it.
    options : tuple of str
        Those of ``fden fit`` that count.

    The module of its name has ``from_file``, which takes a path and :class:`Options`.
    """

    files: tuple[tuple[str, str], ...]
    options: tuple[str, ...] = ()


_ALL = "alpha, G, Gn, Gi, xb"

EXPERIMENTS = {
    "dynamic": Experiment((("omega_rad_s, storage_modulus_pa, loss_modulus_pa", "alpha, G"),)),
    "creep": Experiment((("time_s, strain [, stress_pa]", "alpha, xc, G"),), ("stress", "from")),
    "relaxation": Experiment(
        (
            ("time_s, stress_pa [, strain]", "alpha, fc, G"),
            ("or time_s, relaxation_modulus_pa", "alpha, fc, G"),
            ("or a folder of files at several strains", _ALL),
        ),
        ("strain", "from"),
    ),
    "nonlinearity": Experiment(
        (
            ("stress_pa, strain_coefficient", "G, Gn, Gi, xb"),
            ("or a folder of creep files with stress_pa", _ALL),
        ),
        ("from", "alpha", "alpha-sd"),
    ),
}


def fit_file(kind: str, path: str | Path, options: Options) -> Fit:
    """Fit the experiment `kind` to a CSV file, or to a folder of them where several may be given.

    Raises
    ------
    InputError
        If the file cannot be used; one line that says what would be right.
    """
    from fden_ros.experiments.result import undetermined

    if not Path(path).exists():
        raise InputError(f"{path} does not exist; give a CSV file")
    module = importlib.import_module(f"fden_ros.experiments.{kind}")
    try:
        fit: Fit = module.from_file(Path(path), options)
    except InputError as error:
        # The fit itself does not know the file.
        named = str(path) in str(error)
        raise error if named else InputError(f"{path}: {error}") from None
    return replace(fit, warnings=(*fit.warnings, *undetermined(fit.parameters)))
