"""The names of the measurement methods, in a file of their own so that listing them loads no numerical code."""

METHODS = ("sinestream", "multisine", "chirp")
