# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""fden relative: stiff sites in a table of results."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest

from fden_ros.cli import main

HEADER = ("contact_id", "site", "x", "y", "z", "g", "g_sd", "g_n", "g_n_sd", "alpha", "alpha_sd")
STIFF = 27


def table(path, header=HEADER, extra=()):
    """Six by six sites 5 mm apart, one of them three times stiffer."""
    rng = np.random.default_rng(0)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow((*header, *(name for name, _ in extra)))
        for site in range(1, 37):
            x, y = divmod(site - 1, 6)
            g = 500.0 * math.exp(rng.normal(0.0, 0.08)) * (3.0 if site == STIFF else 1.0)
            row = (site, site, 5e-3 * x, 5e-3 * y, 0.1, g, 0.04 * g, 8.0, 0.2, 0.13, 0.003)
            writer.writerow((*row[: len(header)], *(value for _, value in extra)))
    return path


def relative(capsys, *arguments):
    code = main(["relative", *map(str, arguments)])
    shown = capsys.readouterr()
    return code, shown.out, shown.err


def test_stiff_site_is_found_with_an_interval_and_a_map(tmp_path, capsys):
    picture = tmp_path / "map.png"
    path = table(tmp_path / "results.csv")
    code, out, _ = relative(capsys, path, "--distance", 0.0125, "--map", picture, "--json")
    sites = {int(row["site"]): row for row in json.loads(out)["sites"]}
    assert code == 0 and len(sites) == 36
    stiff = sites.pop(STIFF)
    assert stiff["ratio_low"] < 3.0 < stiff["ratio_high"] < 4.0
    assert stiff["probability"] > 0.99 and stiff["label"] == "stiffer"
    assert all(row["label"] == "alike" for row in sites.values())
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_table_shows_the_stiffest_first_and_is_written(tmp_path, capsys):
    written = tmp_path / "sites.csv"
    code, out, _ = relative(capsys, table(tmp_path / "r.csv"), "--csv", written)
    assert code == 0
    first = next(line for line in out.splitlines() if line.strip()[:2].isdigit())
    assert first.split()[0] == str(STIFF) and "stiffer" in first
    assert len(written.read_text().splitlines()) == 37


def test_last_contact_of_a_site_counts(tmp_path, capsys):
    path = table(tmp_path / "r.csv")
    with path.open("a", newline="") as file:
        row = (37, STIFF, 0.0, 0.0, 0.1, 500.0, 20.0, 8.0, 0.2, 0.13, 0.003)
        csv.writer(file).writerow(row)
    _, out, _ = relative(capsys, path, "--json")
    sites = {int(row["site"]): row for row in json.loads(out)["sites"]}
    assert len(sites) == 36 and sites[STIFF]["label"] == "alike"


@pytest.mark.parametrize(
    ("header", "extra", "arguments", "words"),
    [
        (HEADER[:1], (), (), "column site is missing"),
        (HEADER[:2], (), (), "column g is missing"),
        (HEADER, (("converged", False),), (), "no site with a converged estimate"),
    ],
)
def test_mistake_is_told_in_one_line(tmp_path, capsys, header, extra, arguments, words):
    code, _, error = relative(capsys, table(tmp_path / "r.csv", header, extra), *arguments)
    assert code == 1
    assert words in error and error.count("\n") == 1


def test_distance_needs_positions(tmp_path, capsys):
    path = tmp_path / "r.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(
            [HEADER[1:2] + HEADER[5:], *[(i, 500, 20, 8, 0.2, 0.1, 0.01) for i in range(6)]]
        )
    code, _, error = relative(capsys, path, "--distance", 0.01)
    assert code == 1 and "needs the columns x, y and z" in error
    code, _, error = relative(capsys, path, "--map", tmp_path / "m.png")
    assert code == 1 and "no positions" in error
