# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What can be wrong, and what helps: one table of code, sentence and remedy."""

from __future__ import annotations

import re
from typing import NamedTuple


class Advice(NamedTuple):
    """A problem and its remedy, which is empty if none is known."""

    sentence: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence

    def of(self, **values: object) -> Advice:
        """Return the advice with values in place of its names."""
        return Advice(*(words.format(**values) for words in self))


def _table(text: str) -> dict[str, Advice]:
    rows = (" ".join(row.split()) for row in re.split(r"\n(?=\S)", text.strip()))
    return {code: Advice(*parts) for code, *parts in (row.split(" | ") for row in rows)}


#: By the flag of a contact: what counts most comes first.
FLAGS = _table("""
IMPLAUSIBLE | strain, force, rate or a size is impossible | check the units
GEOMETRY_UNSTATED | the geometry is not stated, so the numbers are those of a default probe
  | state probe and tissue (geometry) to get G and Gn
TOUCH_NOT_OBSERVED | the touch was not observed: the recording lacks it, or noise, drift or
  friction hides it
  | begin with 2 s in the air, and touch within 5 s or with a larger face, to get G and Gn
ESTIMATION_FAILED | the computation failed at this site: there is no estimate until the next site
  | report it, with the traceback of the log
MODEL_MISMATCH | the model does not describe this contact: it mispredicts the force
  | rely on the measured slope, and measure the delay with fden configure
TISSUE_CHANGED | the tissue changed within the contact
  | press elsewhere, or less deeply; if it changes in every contact, measure the delay with
  fden configure
ALPHA_PRIOR_CONFLICT | the relaxation contradicts the stated alpha
  | learn alpha from the data (alpha.learn: true), or state the alpha of this tissue
RIG_PRIOR_CONFLICT | delay, friction, compliance or play is more than 2.5 standard deviations
  off what is stated, so the standard deviations are widened
  | measure the delay with fden configure and state it (displacement.delay), or press a rigid plate
FORCE_DRIFTED | the force in the air after the contact differs from the force before it, so the
  standard deviations are widened | tare, let the sensor warm up, or state force.drift_sd
SATURATED | the force was at its limit: stuck, beyond force.limit, or constant while the probe
  moved on | press less, or raise force.limit if the sensor's limit is higher; if the tissue
  gave way, as with a heartbeat, press again
GAP | samples of this site are missing
  | make the link reliable, and touch elsewhere or let the tissue rest
""")
#: By the source of a variance.
SOURCES = _table("""
noise | noise | press deeper, or use a larger face or a quieter sensor
drift | drift | state force.drift_sd, or press faster
friction | friction | state force.friction_sd, or press harder
motion | motion of the surface | state surface.motion_sd, or press faster
compliance | compliance | state displacement.compliance_sd
backlash | play of the drive | press deeper, or measure the position of the tip
delay | delay | measure it with fden configure
surface | the position of the surface | touch more slowly
law | errors of the law, or a delay
  | measure the delay with fden configure, hold for 2 s, and press here again
thickness | thickness | state geometry.thickness_sd
prior | the width of the prior | hold for 2 s for alpha, or press deeper
""")
#: By what a contact lacks without a flag, and by the parameter at a limit of its prior.
LACKS = _table("""
linear part | noise of {noise} hides the linear part, so G is not observable
  | use a larger face or a quieter sensor
bend | Gn is not observable: the strain reached {strain:.3f}, not clearly beyond the boundary
  1/Gn, about {boundary:.3f} | press to {depth} mm for Gn
settled | the estimator has not settled, or another explanation is equally likely
  | press here again
exact | estimator.kind ekf gives G and Gn only if law and rig are stated to be exact
  | state the zeros of config/bench.yaml and model_discrepancy.sd as 0, or leave estimator.kind out
alpha | alpha is not determined by the data | hold for 2 s for alpha
estimate | there is no estimate
end | the contact was cut short, or data were lost
rejected | {count} samples were rejected during the contact
linear_stiffness | G is at a limit of its prior
  | check units and geometry, or leave prior.* out
nonlinear_stiffness | Gn is at a limit of its prior
  | leave prior.* out, or state prior.nonlinear_stiffness_log_sd as 1
fractional_order | alpha is at a limit of the range of tissue
  | measure the delay with fden configure, or rely on the measured slope
""")
#: By the problem of the samples.
INPUTS = _table("""
displacement sign | the force grows as the displacement falls
  | change the sign of the displacement (displacement.axis, displacement.inverted)
both signs | the force fell below its value in the air, and the displacement falls with it
  | change both signs (force.axis and displacement.axis, or their .inverted), or begin in the air
force sign | the force fell below its value in the air
  | change its sign (force.axis, force.inverted), or begin in the air
touch | the force fell below its value in the air: a faint touch was mistaken for the air, or the
  sensor loses a constant force (piezo), so slopes are too low
  | touch faster, begin in the air, or use a sensor that holds a constant force
drift | the force drifts in the air | tare, or let the sensor warm up
rise | the force rises without a touch | begin in the air (a testing machine's table:
  --from-touch), or, if it drifts, tare and let the sensor warm up
clock | the clock jumped back: everything learned was reset
stuck | the force repeated one value: is the sensor dead, or at its limit?
no pair | no pair of force and displacement: do the stamps of the two topics overlap?
few samples | no contact was found in {count} samples, too few to measure the force in the air
  | record 2 s in the air and then a press
no contact | no contact was found
  | check force.threshold, and the signs of force.axis and displacement.axis: both must grow as
  the probe presses
""")
#: By what keeps the inputs from the node.
TOPICS = _table("""
nothing | nothing publishes {topic}, where {expected} is expected
  | start its publisher, or remap it, {remap}
elsewhere | nothing publishes {topic}, where {expected} is expected, but {other} has that type
  | remap it, {remap}
other type elsewhere | nothing publishes {topic}, where {expected} is expected, but {other}
  is {kind}
  | remap it, {remap}, and set {stream}.message to {name}
type | {topic} is published as {kind}, expected {expected}
  | set {stream}.message to {name}, or remap it, {remap}
unknown type | {topic} is published as {kind}, expected {expected} | remap it, {remap}
reliability | a publisher on {topic} offers best_effort but reliable is requested: nothing
  arrives from it | set {override} to best_effort
several | {topic} has {count} publishers, whose samples are mixed | stop all but one
silent | {topic} is published by {names}, but no message has arrived
zero_stamp | the header stamps of the {stream} are not set
  | set them, or set synchronize.stamp_source to receive
missing_field | no joint of that name has a value | set {stream}.name
no_transform | no transform has the time of a force sample | stamp both with one clock
no pair | do their header stamps overlap, and come from one clock?
  | if not, set synchronize.stamp_source to receive
no clock | use_sim_time is set but nothing publishes /clock
  | play the bag with ros2 bag play --clock, or set use_sim_time to false
two identifiers | {topic} has {count} publishers, whose estimates are mixed
  | stop the other identifier of this name, or rename one with -r __node:=NAME
""")
