"""The site of these pages: ``pip install '.[docs]'``, then ``sphinx-build doc site``."""

import builtins
import collections
import gc
import pkgutil

from sphinx.addnodes import pending_xref

import map_racing

# A build keeps nearly all that it makes: to look for garbage takes a good part of its time.
gc.disable()

project = "map_racing"
version = release = map_racing.__version__
html_title = "map_racing"
html_theme = "furo"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_templates"]
templates_path = ["_templates"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

# The API reference comes from the docstrings; modules of ROS and catkin need not be installed.
autodoc_mock_imports = [
    "ackermann_msgs",
    "diagnostic_msgs",
    "dynamic_reconfigure",
    "genpy",
    "geometry_msgs",
    "map_racing.cfg",
    "map_racing.msg",
    "map_racing.srv",
    "nav_msgs",
    "rosbag",
    "rosgraph",
    "rosgraph_msgs",
    "roslib",
    "rospy",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "visualization_msgs",
]
# Two modules may use the same name; the page shows which is meant.
suppress_warnings = ["ref.python"]
# One page for each package, with all its modules.
autosummary_context = {
    "packages": [
        module.name
        for module in pkgutil.walk_packages(map_racing.__path__, "map_racing.")
        if module.ispkg
    ]
}
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False


# Types of others, and words that napoleon takes for types.
NO_LINKS = {
    *(*dir(builtins), "ndarray", "np.ndarray", "numpy.ndarray", "pathlib.Path", "pandas.DataFrame"),
    *("optional", "callable", "sequence", "iterable", "array_like", "shape", "n", "k", "2"),
}


def skip_field(app, what, name, obj, skip, options):
    """Leave out the fields of named tuples, which the docstring of their class explains."""
    return True if isinstance(obj, collections._tuplegetter) else None


def leave_unlinked(app, doctree):
    """Look for nothing where there is no link: it takes going through all names of the package."""
    for node in list(doctree.findall(pending_xref)):
        if node.get("refdomain") == "py" and node["reftarget"] in NO_LINKS:
            node.replace_self(node.children)


def setup(app):
    """Connect the hooks."""
    app.connect("autodoc-skip-member", skip_field)
    app.connect("doctree-read", leave_unlinked)
