"""What may be asked of a picture or film."""

import math
from dataclasses import dataclass

from linkplan.models.errors import ProblemError
from linkplan.models.extras import load_extra

SUFFIXES = (".mp4", ".gif", ".png")
# Pictures of a few pixels show nothing; beyond the largest OpenGL draws none.
_SMALLEST_PX, _LARGEST_PX = 64, 4096
# A GIF counts time in hundredths of a second, and browsers slow down what is shorter than two.
# In sixteen bits, so that no frame stands longer than eleven minutes.
_MOST_FPS, _MOST_FPS_GIF, _LEAST_FPS = 240.0, 50.0, 0.01
MOST_INSTANTS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderSettings:
    """How a motion is drawn: checked when it is made.

    `slow` times slower than real, None to last some seconds; `size` width and height [px]; `camera` one of the model's by
    name or "azimuth/elevation" in degrees, None for the mechanism's own; `at_s` the one instant [s] of a picture, None for
    `instants` of them; `there_and_back` plays a film backwards after it, so that it goes on without a jump.
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
            raise ProblemError(f"slow, how many times slower than real, is a positive number, got {self.slow:g}")
        most = _MOST_FPS_GIF if self.suffix == ".gif" else _MOST_FPS
        if not (math.isfinite(self.fps) and _LEAST_FPS <= self.fps <= most):
            raise ProblemError(
                f"fps, frames a second of a {self.suffix}, is from {_LEAST_FPS:g} to {most:g}, got {self.fps:g}"
            )
        for side in self.size:
            if not _SMALLEST_PX <= side <= _LARGEST_PX:
                raise ProblemError(
                    f"size is a width and a height from {_SMALLEST_PX} to {_LARGEST_PX} pixels, got"
                    f" {self.size[0]}x{self.size[1]}"
                )
            if self.suffix == ".mp4" and side % 2:
                raise ProblemError(f"an MP4's width and height are even, got {self.size[0]}x{self.size[1]}")
        if self.suffix != ".png" and self.at_s is not None:
            raise ProblemError(f"an instant is a picture's, in a .png; the file ends in {self.suffix}")
        if self.suffix == ".png" and self.there_and_back:
            raise ProblemError("there and back is a film's, in an .mp4 or .gif; the file ends in .png")
        if self.at_s is not None and not (math.isfinite(self.at_s) and self.at_s >= 0):
            raise ProblemError(f"the instant of a picture is a time from 0 on in seconds, got {self.at_s:g}")
        if not 1 <= self.instants <= MOST_INSTANTS:
            raise ProblemError(f"instants in one picture are 1 to {MOST_INSTANTS}, got {self.instants}")


def size_from(text: str) -> tuple[int, int]:
    """Return width and height [px] of "WxH"."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ProblemError(f"size is WIDTHxHEIGHT in pixels, as 800x600, got '{text}'") from None
    return width, height
