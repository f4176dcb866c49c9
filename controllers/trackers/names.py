"""The names of the tracking laws: known without loading what computes them."""

TRACKERS = ("pd", "pd+ff", "lqr")
