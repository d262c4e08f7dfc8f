# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Answer `fden benchmark public DIR --questions mine` by a spring: mine/spring.csv."""

import csv
from collections import defaultdict

import numpy as np

samples = defaultdict(list)
with open("mine/samples.csv", newline="") as file:
    for row in csv.DictReader(file):
        samples[row["question"]].append((float(row["displacement_mm"]), float(row["force_N"])))

with open("mine/questions.csv", newline="") as file, open("mine/spring.csv", "w") as answers:
    writer = csv.writer(answers)
    writer.writerow(("question", "time_s", "value", "sd"))
    for row in csv.DictReader(file):
        depths, forces = np.array(samples[row["question"]]).T
        stiffness = float(forces @ depths / (depths @ depths))  # [N/mm], by least squares
        value = {
            "stiffness": 1e3 * stiffness,  # [N/m]
            "force": stiffness * float(row["displacement_mm"]),  # [N]
            "alpha": 0.0,
        }[row["asked"]]
        writer.writerow((row["question"], row["time_s"], value, ""))
