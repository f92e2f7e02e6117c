"""The catkin package: lint, install space, command line, entry points."""

import os
import subprocess
from xml.etree import ElementTree

from map_racing import __version__, resources


def run(*command, **options):
    """Output of a command that must succeed."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options)
    output = done.stdout.decode(errors="replace")
    assert done.returncode == 0, output
    return output


def test_the_command_line_works_from_the_workspace(roscore, request):
    assert run("rosrun", "map_racing", "map-racing", "--version").split()[-1] == __version__
    root = request.config.rootpath.resolve()
    assert resources.config_directory() == root / "config"


def test_package_and_python_have_one_version(request):
    root = ElementTree.parse(request.config.rootpath / "package.xml").getroot()
    assert root.findtext("version") == __version__


def test_catkin_lint(request):
    output = run(
        *("/usr/bin/catkin_lint", "-W2", "--offline"),
        request.config.rootpath,
        env={**os.environ, "PATH": "/usr/bin:/bin"},
    )
    assert "checked 1 packages and found 0 problems" in output, output
