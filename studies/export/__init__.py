"""Plans for other programs: keyframes of MuJoCo, joint trajectories of ROS, MATLAB, CSV and Parquet.

In: a plan, and how far its samples are apart. Out: a file's content.
"""
