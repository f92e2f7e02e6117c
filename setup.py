"""Packages and data files; the rest of the metadata is in pyproject.toml.

catkin reads the packages from here, so this file may use nothing beyond setuptools, and every
package must lie below ``src``.
"""

from glob import glob
from os.path import dirname

from setuptools import find_packages, setup

DATA = sorted({dirname(path) for path in glob("config/**/*.*", recursive=True)})

setup(
    name="map_racing",
    package_dir={"": "src"},
    packages=find_packages("src"),
    data_files=[(f"share/map_racing/{folder}", glob(f"{folder}/*.*")) for folder in DATA],
)
