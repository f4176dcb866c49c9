"""Plans for other programs: keyframes of MuJoCo, ROS, MATLAB, CSV and Parquet; C code of control laws and models.

In: a plan and the time between samples, or a mechanism. Out: a file's content, or a folder of C99 with its cost.
"""
