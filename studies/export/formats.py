"""What a plan is exported to, by name: known without loading what writes it."""

FORMATS = {
    "keyframes": "an MJCF file of <keyframe>s to include",
    "mjcf": "the whole model with them",
    "ros": "trajectory_msgs/JointTrajectory as YAML",
    "mat": "MATLAB",
    "csv": "a table",
    "parquet": "a table, units in its schema",
}
