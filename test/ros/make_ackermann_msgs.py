"""Write a message-only substitute for ``ackermann_msgs`` into a test workspace.

Debian and Ubuntu have no such package. On a car the real one is a dependency of its drivers.
"""

import sys
from pathlib import Path

from map_racing.bags.messages import DEFINITIONS

PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>ackermann_msgs</name>
  <version>0.0.0</version>
  <description>Stand-in for tests: the two messages of ackermann_msgs.</description>
  <maintainer email="maintainers@map-racing.example">The map_racing authors</maintainer>
  <license>BSD-3-Clause</license>
  <buildtool_depend>catkin</buildtool_depend>
  <build_depend>message_generation</build_depend>
  <depend>std_msgs</depend>
  <exec_depend>message_runtime</exec_depend>
</package>
"""
CMAKE = """cmake_minimum_required(VERSION 3.0.2)
project(ackermann_msgs)
find_package(catkin REQUIRED COMPONENTS message_generation std_msgs)
add_message_files(DIRECTORY msg)
generate_messages(DEPENDENCIES std_msgs)
catkin_package(CATKIN_DEPENDS message_runtime std_msgs)
"""


def main(folder):
    """Write the package; unchanged files keep their date."""
    files = {"package.xml": PACKAGE, "CMakeLists.txt": CMAKE}
    for name, definition in DEFINITIONS.items():
        package, _, message = name.split("/")
        if package == "ackermann_msgs":
            files[f"msg/{message}.msg"] = definition
    for name, content in files.items():
        path = Path(folder) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text() != content:
            path.write_text(content)


if __name__ == "__main__":
    main(sys.argv[1])
