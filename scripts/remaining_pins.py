"""Print the pins of a lock file that this interpreter lacks, ROS packages left out.

Usage: python remaining_pins.py LOCK
"""

import re
import sys
from importlib.metadata import distributions
from pathlib import Path


def normalized(name: str) -> str:
    """Return the name of a distribution as PEP 503 compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


present = {normalized(d.metadata["Name"]) for d in distributions() if d.metadata["Name"]}
for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
    pin = re.match(r"([A-Za-z0-9._-]+)==", line)
    if not pin:
        continue
    name = normalized(pin.group(1))
    if name not in present and not name.startswith("ros-"):
        print(line)
