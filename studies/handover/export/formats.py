"""The names and descriptions of export formats. This file does not load the code that writes them."""

from linkplan.controllers.trackers.names import BUILT_IN

FORMATS = {
    "keyframes": "an MJCF file of <keyframe>s to include",
    "mjcf": "the whole model with them",
    "ros": "trajectory_msgs/JointTrajectory as YAML",
    "mat": "MATLAB",
    "csv": "a table",
    "parquet": "a table, units in its schema",
}
# Formats that are folders.
FOLDER_FORMATS = {"c": "a model's dynamics or a plan's control law in C99, a folder"}
# The trackers that are tables in C.
C_TRACKERS = tuple(name for name, one in BUILT_IN.items() if one.in_c)
