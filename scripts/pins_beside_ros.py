"""Print the pins of a lock file that are installed beside a ROS 2 that the system has.

ROS itself, and what it is built on or with, is left to the system: another numpy than the one that
its extension modules were compiled for would break them.
Usage: python pins_beside_ros.py LOCK
"""

import re
import sys
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

OF_THE_SYSTEM = (
    "numpy", "scipy", "matplotlib", "pyyaml", "catkin-pkg", "empy", "lark", "lark-parser",
)  # fmt: skip


def normalized(name: str) -> str:
    """Return the name of a distribution as PEP 503 compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def with_requirements(name: str, found: set[str]) -> set[str]:
    """Add to `found` a distribution and all that it needs, as far as they are installed."""
    if name not in found:
        found.add(name)
        try:
            needed = requires(name) or []
        except PackageNotFoundError:
            needed = []
        for requirement in needed:
            if "extra ==" not in requirement:
                with_requirements(normalized(re.split(r"[^\w.-]", requirement)[0]), found)
    return found


of_the_system: set[str] = set()
for distribution in OF_THE_SYSTEM:
    with_requirements(distribution, of_the_system)
of_the_system.discard("setuptools")  # the system's may be too old to install the project

for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
    name = line.partition("==")[0]
    if not line.startswith(("#", "ros-")) and name not in of_the_system:
        print(line)
