"""The names of the ways to measure a loop: known without loading what measures."""

METHODS = ("sinestream", "multisine", "chirp")
