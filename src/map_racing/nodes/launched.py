"""Arguments of roslaunch, which ignores those that it does not know."""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path
from xml.etree import ElementTree

from ..errors import ParameterError
from ..resources import config_directory

__all__ = ["check_launch_arguments"]

# What the shipped files pass all their arguments on to.
_PASSED_ON = "include/nodes.launch"


def check_launch_arguments(words: list[str] | None = None) -> None:
    """Refuse a misspelled argument, with which the car would drive otherwise than was meant.

    Parameters
    ----------
    words : list of str, optional
        The command line of roslaunch; by default that of the process that started this one. What
        is none, or launches other files than the shipped ones, is not judged.

    Raises
    ------
    ParameterError
        Naming the argument, and those that are spelled like it.
    """
    words = _command_of_parent() if words is None else words
    programs = [i for i, word in enumerate(words[:3]) if Path(word).name == "roslaunch"]
    if not programs:
        return
    words = [word for word in words[programs[0] + 1 :] if not word.startswith("-")]
    given = [word.partition(":=")[0] for word in words if ":=" in word]
    files = [word for word in words if ":=" not in word]
    folder = config_directory().parent / "launch"
    shipped = len(files) == 2 and files[0] == "map_racing" and (folder / files[1]).is_file()
    if not shipped:
        return
    known = {
        argument.get("name")
        for file in (files[1], _PASSED_ON)
        for argument in ElementTree.parse(folder / file).getroot().findall("arg")
    }
    for name in given:
        if name not in known and not name.startswith("_"):
            near = get_close_matches(name, known)
            like = f" (like {' or '.join(near)})" if near else ""
            raise ParameterError(
                f"roslaunch {files[1]}: expected an argument that roslaunch --ros-args map_racing "
                f"{files[1]} lists, got {name}{like}"
            )


def _command_of_parent():
    """Words of the command that started this process; empty where they cannot be read."""
    try:
        return Path(f"/proc/{os.getppid()}/cmdline").read_text().split("\0")[:-1]
    except (OSError, ValueError):
        return []
