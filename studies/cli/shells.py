"""The shells that completion is written for."""

SHELLS = ("bash", "zsh", "fish")
