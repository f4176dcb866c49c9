"""Plans for other programs: keyframes of MuJoCo, joint trajectories of ROS, MATLAB, CSV and Parquet.

In: a plan, and the time between samples. Out: a file's content.
"""
