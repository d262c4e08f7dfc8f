# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Labelled contacts to learn from: recordings of known tissue."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fden_ros.core.classification import UNKNOWN
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource
from fden_ros.errors import InputError
from fden_ros.offline.batch import find_bags
from fden_ros.offline.replay import replay
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.source import Selection
from fden_ros.tissues.training import Contacts, contacts_of

_LABEL = re.compile(r"(?P<tissue>[^=/]+)(?:/(?P<specimen>[^=]+))?=(?P<path>.+)", re.DOTALL)
_NOT_CONVERGED, _NO_ESTIMATE = "not converged", "without an estimate"


@dataclass(frozen=True)
class Source:
    """One argument: where contacts are, and what is known of all of them."""

    path: Path
    tissue: str
    specimen: str = ""

    @staticmethod
    def parse(text: str) -> Source:
        """Return the source of ``TISSUE=PATH`` or ``TISSUE/SPECIMEN=PATH``.

        Raises
        ------
        InputError
            If no tissue is named, or it is called as what fits none.
        """
        match = None if Path(text).exists() else _LABEL.fullmatch(text)
        if match is None:
            raise InputError(
                f"{text}: which tissue is it? Write TISSUE={text}, or TISSUE/SPECIMEN={text}"
            )
        tissue = match["tissue"].strip()
        if tissue == UNKNOWN:
            raise InputError(
                f"{text}: a tissue cannot be called `{UNKNOWN}`: that is what fits none; leave "
                "these contacts out"
            )
        return Source(Path(match["path"]), tissue, match["specimen"] or "")


def read_source(
    source: Source, parameters: Parameters, selection: Selection | None = None
) -> Contacts:
    """Return the contacts of a recording, or of a folder of bags.

    Parameters
    ----------
    source : Source
    parameters : Parameters
        With which recordings are identified; the prior in them is taken out of the results.
    selection : Selection, optional
        Topics, fields or columns.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    if not source.path.exists():
        raise InputError(
            f"{source.path}: no such file or folder; give TISSUE=BAG or TISSUE/SPECIMEN=BAG"
        )
    # What the present library makes of them does not matter, nor whether it fits.
    own = parameters.changed({"classifier.library": ""})
    skipped: Counter[str] = Counter()
    used = []
    for summary in _summaries(source, own, selection):
        if summary.estimate is None:
            skipped[_NO_ESTIMATE] += 1
        elif not summary.converged:
            skipped[_NOT_CONVERGED] += 1
        else:
            used.append((summary, summary.estimate))
    return contacts_of(
        [source.tissue for _ in used],
        [source.specimen for _ in used],
        np.array([estimate.mean for _, estimate in used]).reshape(-1, 3),
        np.array([estimate.covariance for _, estimate in used]).reshape(-1, 3, 3),
        pipeline_config(own).estimator.prior,
        [summary.order_source is not OrderSource.GIVEN for summary, _ in used],
        sources=(str(source.path),),
        mismatched=sum(bool(summary.flags & Flag.MODEL_MISMATCH) for summary, _ in used),
        skipped=dict(skipped),
    )


def _summaries(
    source: Source, parameters: Parameters, selection: Selection | None
) -> Iterator[ContactSummary]:
    for bag in find_bags([str(source.path)]):
        yield from replay(bag, parameters, selection).summaries
