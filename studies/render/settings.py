"""The settings of a picture or film."""

import math
from dataclasses import dataclass

from linkplan.models.errors import ProblemError
from linkplan.models.extras import load_extra

SUFFIXES = (".mp4", ".gif", ".png")


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderSettings:
    """How a motion is drawn; the values are checked at construction.

    `slow` is the slowness, None for a film of a few seconds; `size` is width and height [px]; `camera` is the name of a
    camera of the model or "azimuth/elevation" in degrees, None for the default; `at_s` is the instant [s] of a picture, None
    for `instants` of them; with `there_and_back` the film then plays backwards, so that it repeats without a jump.
    """

    suffix: str
    tracker: str = "pd+ff"
    slow: float | None = None
    fps: float = 25.0
    size: tuple[int, int] = (800, 600)
    camera: str | None = None
    at_s: float | None = None
    instants: int = 7
    there_and_back: bool = False

    def __post_init__(self) -> None:
        if self.suffix == ".mp4":
            load_extra("av", "an .mp4")
        if self.slow is not None and not (math.isfinite(self.slow) and self.slow > 0):
            raise ProblemError(f"slow must be a positive number, how many times slower than real time, got {self.slow:g}")
        # A GIF counts time in hundredths of a second, in 16 bits; browsers slow down frames of less than two hundredths.
        least, most = 0.01, 50.0 if self.suffix == ".gif" else 240.0
        if not (math.isfinite(self.fps) and least <= self.fps <= most):
            raise ProblemError(
                f"fps, frames per second of a {self.suffix}, must be from {least:g} to {most:g}, got {self.fps:g}"
            )
        smallest, largest = 64, 4096  # the largest pictures of OpenGL
        got = f"{self.size[0]}x{self.size[1]}"
        if not all(smallest <= side <= largest for side in self.size):
            raise ProblemError(f"size must be a width and a height from {smallest} to {largest} pixels, got {got}")
        if self.suffix == ".mp4" and any(side % 2 for side in self.size):
            raise ProblemError(f"an MP4's width and height must be even, got {got}")
        if self.suffix != ".png" and self.at_s is not None:
            raise ProblemError(f"at_s is for pictures (.png); the file ends in {self.suffix}")
        if self.suffix == ".png" and self.there_and_back:
            raise ProblemError("there_and_back is for films (.mp4 or .gif); the file ends in .png")
        if self.at_s is not None and not (math.isfinite(self.at_s) and self.at_s >= 0):
            raise ProblemError(f"at_s must be a time of at least 0 s, got {self.at_s:g}")
        if not 1 <= self.instants <= 40:
            raise ProblemError(f"instants must be from 1 to 40, got {self.instants}")
