"""Checks the arguments of roslaunch, which ignores unknown ones."""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path
from xml.etree import ElementTree

from ..errors import ParameterError
from ..resources import config_directory

__all__ = ["check_launch_arguments"]

# The shipped launch files pass all their arguments on to this one.
_PASSED_ON = "include/nodes.launch"


def check_launch_arguments(words: list[str] | None = None) -> None:
    """Refuse an argument without effect: misspelled, or set by the launch file itself.

    Otherwise the car would not drive as intended.

    Parameters
    ----------
    words : list of str, optional
        The command line of roslaunch; by default that of the parent process. Other commands and
        launch files are not checked.

    Raises
    ------
    ParameterError
        Naming the argument, and similar ones.
    """
    words = _command_of_parent() if words is None else words
    programs = [i for i, word in enumerate(words[:3]) if Path(word).name == "roslaunch"]
    if not programs:
        return
    words = [word for word in words[programs[0] + 1 :] if not word.startswith("-")]
    given = [word.partition(":=")[0] for word in words if ":=" in word]
    folder = config_directory().parent / "launch"
    # Option values, as in -p 11312, may be anywhere in between.
    after = words[words.index("map_racing") :] if "map_racing" in words else []
    file = next((word for word in after if (folder / word).is_file()), None)
    if file is None:
        return
    known = _arguments(folder, file)
    for name in given:
        if name not in known and not name.startswith("_"):
            near = get_close_matches(name, known)
            like = f" (like {' or '.join(near)})" if near else ""
            raise ParameterError(
                f"roslaunch {file}: expected an argument that roslaunch --ros-args map_racing "
                f"{file} lists, got {name}{like}"
            )


def _arguments(folder, file):
    """Names of the arguments that a user can set, without those that the files set themselves."""
    own, inner = (ElementTree.parse(folder / one).getroot() for one in (file, _PASSED_ON))
    known, passed = (
        {one.get("name") for one in root.findall("arg") if "value" not in one.attrib}
        for root in (own, inner)
    )
    for include in own.findall("include"):
        known |= passed - {one.get("name") for one in include.findall("arg")}
    return known


def _command_of_parent():
    """Words of the parent process's command; empty if they cannot be read."""
    try:
        return Path(f"/proc/{os.getppid()}/cmdline").read_text().split("\0")[:-1]
    except (OSError, ValueError):
        return []
