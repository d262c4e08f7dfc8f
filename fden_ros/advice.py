# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What can be wrong, and what helps: one table of code, sentence and remedy."""

from __future__ import annotations

import re
from typing import NamedTuple


class Advice(NamedTuple):
    """What is wrong, and what helps; an empty remedy: nothing is known to."""

    sentence: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence

    def of(self, **values: object) -> Advice:
        """Return it with values in its places."""
        return Advice(*(words.format(**values) for words in self))


def _table(text: str) -> dict[str, Advice]:
    rows = (" ".join(row.split()) for row in re.split(r"\n(?=\S)", text.strip()))
    return {code: Advice(*parts) for code, *parts in (row.split(" | ") for row in rows)}


#: By the flag of a contact: what counts most comes first.
FLAGS = _table("""
IMPLAUSIBLE | strain, force, rate or a size cannot be what it says | check the units
GEOMETRY_UNSTATED | the geometry is not stated: the numbers are those of a probe that stands in
  for it | state probe and tissue (geometry) for G and Gn
TOUCH_NOT_OBSERVED | the touch was not observed, in the recording or above noise and drift
  | begin 1 s in the air, and touch within 5 s or with a larger face, for G and Gn
ESTIMATION_FAILED | the computation failed at this site: there is no estimate until the next one
  | report it, with the traceback of the log
MODEL_MISMATCH | the model does not describe this contact: the force is not what it predicts
  | rely on the measured slope
TISSUE_CHANGED | the tissue changed within the contact | press elsewhere, or less deep
ALPHA_PRIOR_CONFLICT | the relaxation contradicts the stated alpha
  | leave alpha to the data (alpha.learn: true), or state what this tissue has
RIG_PRIOR_CONFLICT | delay, friction or compliance is more than 2.5 standard deviations off what is
  stated, and the deviations are widened
  | measure the delay by fden configure and state it (displacement.delay), or press a rigid plate
FORCE_DRIFTED | the force in the air after the contact was not that before it, and the deviations
  are widened by as much | tare, let the sensor warm up, or state force.drift_sd
SATURATED | the force was at its end: stuck, beyond force.limit, or still while the probe went on
  | press less, or raise force.limit where it is below the sensor's
GAP | samples are missing within this site's memory | make the link reliable
""")
#: By the source of a variance.
SOURCES = _table("""
noise | noise | press deeper, or use a larger face or a quieter sensor
drift | drift | state force.drift_sd, or press faster
friction | friction | state force.friction_sd, or press harder
motion | motion of the surface | state surface.motion_sd, or press faster
compliance | compliance | state displacement.compliance_sd
backlash | play of the drive | press deeper, or measure the tip
delay | delay | measure it by fden configure
surface | the place of the surface | touch it slower
law | errors of the law | hold for 2 s, and press here again
thickness | thickness | state geometry.thickness_sd
prior | what the prior leaves open | hold for 2 s for alpha, or press deeper
""")
#: By what a contact lacks without a flag, and by the parameter at a limit of its prior.
LACKS = _table("""
linear part | {noise} of noise hide the linear part, so G is not observable
  | use a larger face or a quieter sensor
bend | Gn is not observable: the strain reached {strain:.3f} and did not surely pass the boundary
  1/Gn, about {boundary:.3f} | press to {depth} mm for Gn
settled | not converged: the estimator has not settled, or another explanation is as likely
  | press here once more
alpha | alpha is not determined by the data | hold for 2 s for alpha
estimate | there is no estimate
end | the contact was cut short, or data were lost
rejected | {count} samples were rejected during the contact
linear_stiffness | G lies at a limit of its prior
  | check units and geometry, or leave prior.* out
nonlinear_stiffness | Gn lies at a limit of its prior
  | leave prior.* out, or state prior.nonlinear_stiffness_log_sd as 1
fractional_order | alpha lies at a limit of what tissue has
  | measure the delay by fden configure, or rely on the measured slope
""")
#: By what is odd about the samples, the likeliest remedy first.
INPUTS = _table("""
displacement sign | the force grows as the displacement falls
  | change the sign of the displacement (displacement.axis, displacement.inverted)
both signs | the force fell below its value in the air, and the displacement falls with it
  | change both signs (force.axis and displacement.axis, or their .inverted), or begin in the air
force sign | the force fell below its value in the air
  | change its sign (force.axis, force.inverted), or begin in the air
touch | the force fell below its value in the air, where a faint touch was taken for the air
  | touch faster, or begin in the air
drift | the force drifts in the air | tare, or let the sensor warm up
rise | the force rises without a touch | begin in the air (a testing machine's table:
  --from-touch), or where it drifts tare and let the sensor warm up
clock | the clock jumped back: everything learned was reset
stuck | the force repeated one value: is the sensor dead, or at its end?
no pair | no pair of force and displacement: do the stamps of the two topics overlap?
no contact | no contact was found
  | check force.axis and displacement.axis (both grow as the probe presses) and force.threshold
""")
#: By what keeps the inputs from the node.
TOPICS = _table("""
nothing | nothing publishes {topic}, where {expected} is expected
  | start its publisher, or remap it, {remap}
elsewhere | nothing publishes {topic}, where {expected} is expected: {other} has that type
  | remap it, {remap}
other type elsewhere | nothing publishes {topic}, where {expected} is expected: {other} is {kind}
  | remap it, {remap}, and set {stream}.message to {name}
type | {topic} is published as {kind}, expected {expected}
  | set {stream}.message to {name}, or remap it, {remap}
unknown type | {topic} is published as {kind}, expected {expected} | remap it, {remap}
reliability | a publisher on {topic} offers best_effort where reliable is requested: nothing comes
  from it | set {override} to best_effort
several | {topic} has {count} publishers: their samples are mixed
silent | {topic} is published by {names}, but no message has come from it
zero_stamp | the header stamps of the {stream} are not set
  | set them, or set synchronize.stamp_source to receive
missing_field | no joint of that name has the value | set {stream}.name
no_transform | no transform has the time of a force | stamp both by one clock
no pair | do their header stamps overlap, and are they of one clock?
  | if not, set synchronize.stamp_source to receive
no clock | use_sim_time is set but nothing publishes /clock
  | play the bag with ros2 bag play --clock, or set use_sim_time to false
two identifiers | {topic} has {count} publishers, whose estimates are mixed
  | end the other identifier of this name, or name it with -r __node:=NAME
""")
