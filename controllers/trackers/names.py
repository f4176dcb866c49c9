"""The names of the tracking laws, in a file of their own so that listing them loads no numerical code."""

LINEAR = ("pd", "pd+ff", "lqr")
"""Linear state feedback laws: frequency responses and tuning support these, and a comparison uses them by default."""

TRACKERS = (*LINEAR, "lqi", "gs-pd+ff", "ct", "mpc")
"""All tracking laws."""
