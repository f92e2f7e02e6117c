"""Packages, data files and version; the rest of the metadata is in pyproject.toml.

catkin reads version and packages from here, so this file may use nothing beyond setuptools, and
every package must lie below ``src``.
"""

import re
from glob import glob
from os.path import dirname

from setuptools import find_packages, setup

DATA = sorted({dirname(path) for path in glob("config/**/*.*", recursive=True)})

with open("src/map_racing/__init__.py", encoding="utf-8") as module:
    VERSION = re.search(r'^__version__ = "(.+)"', module.read(), re.MULTILINE).group(1)

setup(
    name="map_racing",
    version=VERSION,
    package_dir={"": "src"},
    packages=find_packages("src"),
    data_files=[(f"share/map_racing/{folder}", glob(f"{folder}/*.*")) for folder in DATA],
)
