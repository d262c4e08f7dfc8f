"""Point the CMake files of the ROS wheels at this machine's Python and numpy.

The exported targets carry the include paths of the machine that built the wheels.
Usage: python relocate_wheels.py VENV   (with the environment's own interpreter)
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

PYTHON_INCLUDE = re.compile(r"/opt/python/[^;\"]*/include/python3\.\d+")
NUMPY_INCLUDE = re.compile(r"/opt/python/[^;\"]*/site-packages/numpy/_core/include")

for path in Path(sys.argv[1], "share").rglob("*.cmake"):
    text = path.read_text(encoding="utf-8")
    relocated = PYTHON_INCLUDE.sub(sysconfig.get_path("include"), text)
    relocated = NUMPY_INCLUDE.sub(np.get_include(), relocated)
    if relocated != text:
        path.write_text(relocated, encoding="utf-8")
