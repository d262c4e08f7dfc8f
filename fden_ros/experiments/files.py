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

"""From CSV files to fits: what ``fden fit KIND FILE`` reads for each kind."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.geometry import TorsionalRheometer
from fden_ros.errors import InputError
from fden_ros.experiments.columns import Table, csv_files, read_table
from fden_ros.experiments.creep import fit_creep
from fden_ros.experiments.dynamic import fit_bode, fit_complex_modulus
from fden_ros.experiments.indentation import fit_indentation
from fden_ros.experiments.nonlinearity import CreepTest, fit_creep_series, fit_nonlinearity
from fden_ros.experiments.relaxation import Hold, fit_relaxation
from fden_ros.experiments.result import Fit, undetermined

#: The paper leaves the first second of a creep test out: the rheometer still vibrates.
CREEP_START = 1.0
#: A held quantity may vary by this part of its mean.
_CONSTANT = 0.02


@dataclass(frozen=True)
class Options:
    """What a file does not say itself.

    Parameters
    ----------
    stress : float, optional
        Constant stress of a creep test [Pa].
    strain : float, optional
        Held strain of a relaxation test [1].
    start : float, optional
        Rows before this time [s] are left out; None: 1 s for creep, else nothing.
    ramp : float
        Time in which the strain of a relaxation test rises [s].
    alpha, alpha_sd : float
        Fractional order from elsewhere, and its deviation.
    paper_convention : bool
        Nonlinearity without the factor Gamma(1+alpha), as the paper computes it.
    sample : TorsionalRheometer, optional
        The sample's radius and height, for torque and angle.
    """

    stress: float | None = None
    strain: float | None = None
    start: float | None = None
    ramp: float = 0.0
    alpha: float | None = None
    alpha_sd: float = 0.0
    paper_convention: bool = False
    sample: TorsionalRheometer | None = None


def fit_file(kind: str, path: str | Path, options: Options) -> Fit:
    """Fit the experiment `kind` to a CSV file, or to a folder of them where several may be given.

    Raises
    ------
    InputError
        If the file cannot be used; one line that says what would be right.
    """
    if not Path(path).exists():
        raise InputError(f"{path} does not exist; give a CSV file")
    fit = READERS[kind](Path(path), options)
    return replace(fit, warnings=(*fit.warnings, *undetermined(fit.parameters)))


def _dynamic(path: Path, options: Options) -> Fit:
    table = read_table(path)
    columns = [table.positive(n) for n in ("omega_rad_s", "storage_modulus_pa", "loss_modulus_pa")]
    table.require_rows(2, "a dynamic fit")
    return fit_complex_modulus(*columns)


def _bode(path: Path, options: Options) -> Fit:
    table = read_table(path)
    omega, gain = table.positive("omega_rad_s"), table.positive("gain_per_pa")
    phase = table.column("phase_rad")
    table.require_rows(2, "a Bode fit")
    return _named(path, lambda: fit_bode(omega, gain, phase))


def _creep(path: Path, options: Options) -> Fit:
    return fit_creep(*_creep_test(path, options))


def _nonlinearity(path: Path, options: Options) -> Fit:
    if path.is_dir():
        tests = [_creep_test(p, replace(options, stress=None)) for p in csv_files(path)]
        if len({test.stress for test in tests}) < 3:
            raise InputError(
                f"{path} holds creep tests at fewer than 3 stresses; nonlinearity needs 3 or more"
            )
        return fit_creep_series(tests)
    table = read_table(path)
    coefficient = table.positive("strain_coefficient")
    stress = table.require_positive("stress_pa", table.stress(options.sample))
    table.checked_strain(coefficient)
    table.require_rows(3, "a nonlinearity fit")
    alpha = None if options.paper_convention else options.alpha
    fit = _named(path, lambda: fit_nonlinearity(stress, coefficient, alpha, options.alpha_sd))
    if alpha is not None or options.paper_convention:
        return fit
    hint = (
        "without --alpha the paper's convention f_c = phi(x_c) is used: if x_c are the strains of "
        "creep tests at 1 s, this G is G Gamma(1+alpha), some 7 % less than G"
    )
    return replace(fit, warnings=(*fit.warnings, hint))


def _relaxation(path: Path, options: Options) -> Fit:
    paths = csv_files(path) if path.is_dir() else [path]
    holds = [hold for p in paths for hold in _holds(p, options)]
    return fit_relaxation(holds, options.ramp)


def _indentation(path: Path, options: Options) -> Fit:
    table = read_table(path)
    time, strain = table.times(), table.strain(options.sample)
    stress = table.stress(options.sample)
    table.require_rows(6, "an indentation fit")
    return _named(
        path, lambda: fit_indentation(time, strain, stress, options.alpha, options.alpha_sd)
    )


READERS = {
    "dynamic": _dynamic,
    "bode": _bode,
    "creep": _creep,
    "nonlinearity": _nonlinearity,
    "relaxation": _relaxation,
    "indentation": _indentation,
}


def _creep_test(path: Path, options: Options) -> CreepTest:
    table = read_table(path)
    time, strain = table.times(), table.strain(options.sample)
    if options.stress is not None:
        stress = options.stress
    elif "stress_pa" in table or "torque_n_m" in table:
        stress = _held(path, "stress_pa", table.stress(options.sample))
    else:
        raise InputError(f"{path} does not say the stress; give --stress PA or a column stress_pa")
    if not stress > 0.0:
        raise InputError(f"{path}: the stress is {stress:g} Pa; it must be positive")
    used = _used(table, time, CREEP_START if options.start is None else options.start)
    time, strain = time[used.kept], strain[used.kept]
    used.table.require_rows(2, "a creep fit")
    used.table.require_positive("time_s", time)
    used.table.require_positive("strain", strain)
    return CreepTest(time, strain, stress)


def _holds(path: Path, options: Options) -> list[Hold]:
    table = read_table(path)
    has_strain = "strain" in table or "angle_rad" in table
    if options.strain is None and not has_strain:
        raise InputError(f"{path} does not say the strain; give --strain X or a column strain")
    if options.strain is not None:
        levels = np.full(len(table.rows), options.strain)
    else:
        levels = _strain_levels(path, table, options)
    table.require_positive("strain", levels, "a relaxation test holds a strain")
    time = table.times(restart_where=levels)
    stress = table.stress(options.sample)
    start = options.start
    if options.ramp > 0.0:
        # The first sample must lie after the ramp, where alone the hold's formula holds.
        start = max(start or 0.0, float(np.nextafter(options.ramp, math.inf)))
    used = _used(table, time, start)
    used.table.require_rows(2, "a relaxation fit")
    used.table.require_positive("time_s", time[used.kept], "its logarithm is taken (see --from)")
    used.table.require_positive("stress_pa", stress[used.kept])
    holds = []
    for level in dict.fromkeys(levels[used.kept].tolist()):
        some = used.kept & (levels == level)
        if np.count_nonzero(some) < 2:
            raise InputError(f"{path}: strain {level:g} has a single row; each needs at least 2")
        holds.append(Hold(time[some], stress[some], level))
    return holds


def _strain_levels(path: Path, table: Table, options: Options) -> Array:
    strain = table.strain(options.sample)
    if np.ptp(strain) <= _CONSTANT * abs(float(strain.mean())):
        return np.full(strain.size, float(strain.mean()))
    if np.unique(strain).size > max(strain.size // 2, 1):
        raise InputError(
            f"{path}: strain is not held, it goes from {strain.min():g} to {strain.max():g}; "
            "cut the hold out and give --strain X, or fit the whole as indentation"
        )
    return strain


@dataclass(frozen=True)
class _Used:
    """The rows that a fit uses."""

    kept: np.ndarray
    table: Table


def _used(table: Table, time: Array, start: float | None) -> _Used:
    kept = np.ones(time.size, dtype=bool) if start is None else time >= start
    if not kept.any():
        raise InputError(
            f"{table.path} ends at {time.max():g} s, before the first row to use at {start:g} s; "
            "give --from S"
        )
    rows = tuple(row for row, use in zip(table.rows, kept, strict=True) if use)
    lines = tuple(line for line, use in zip(table.lines, kept, strict=True) if use)
    return _Used(kept, replace(table, rows=rows, lines=lines))


def _held(path: Path, name: str, values: Array) -> float:
    mean = float(values.mean())
    if np.ptp(values) > _CONSTANT * abs(mean):
        raise InputError(
            f"{path}: {name} goes from {values.min():g} to {values.max():g}; a creep test has one "
            "stress: one file each"
        )
    return mean


def _named(path: Path, fit) -> Fit:  # type: ignore[no-untyped-def]
    """Run a fit and put the file's name before what it finds wrong."""
    try:
        result: Fit = fit()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return result
