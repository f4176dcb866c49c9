"""The shells with completion."""

SHELLS = ("bash", "zsh", "fish")
