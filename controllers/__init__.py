"""Trackers, which turn a reference into efforts, and the closed-loop simulation in MuJoCo that tests them."""
