"""The names of the tracking laws: known without loading what computes them."""

LINEAR = ("pd", "pd+ff", "lqr")
"""Laws of one gain on the state: those that frequency responses and tuning know, and that are compared if none is named."""

TRACKERS = (*LINEAR, "lqi", "gs-pd+ff", "ct", "mpc")
"""All."""
