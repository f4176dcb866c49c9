"""The caption of a picture: time, slowness, and each effort with its limit."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from linkplan.studies.render.motion import TrackedMotion
from linkplan.studies.render.shapes import load_colour

# The smallest legible height of letters [px].
_MIN_LETTERS_PX = 11
# The lines of further efforts are omitted.
_MAX_EFFORT_LINES = 6
INK = (30, 30, 30)

Line = tuple[str, tuple[int, int, int]]


def frame_lines(motion: TrackedMotion, k: int, slow: float) -> list[Line]:
    """Return the lines on a frame at control instant k: time and slowness, then each effort in its load's colour."""
    decimals = max(0, int(np.ceil(-np.log10(motion.duration_s))) + 2)
    pace = f"  {slow:g}x slower" if slow > 1 else f"  {1 / slow:g}x faster" if slow < 1 else ""
    return [(f"t = {motion.time_s[k]:.{decimals}f} s{pace}", INK), *effort_lines(motion, k)]


def head_share(motion: TrackedMotion, size: tuple[int, int]) -> float:
    """Return the share of a picture's height that its caption takes, for a size in pixels."""
    lines = 1 + min(motion.mechanism.n_u, _MAX_EFFORT_LINES + 1)
    letters = _letters_px(size[1], size[0])
    return min(0.4, (lines * 1.25 + 1.0) * letters / size[1])


def effort_lines(motion: TrackedMotion, k: int) -> list[Line]:
    """Return a line on each effort at control instant k, with its limit, in its load's colour."""
    lines = []
    for actuator, effort, limit, share in zip(
        motion.mechanism.actuators, motion.effort[k], motion.limit, motion.shares[k], strict=True
    ):
        end = limit[0] if effort < 0 else limit[1]
        most = f" of {end:.4g}" if np.isfinite(end) else ""
        red, green, blue, _ = load_colour(float(share))
        darker = tuple(int(255 * 0.85 * c) for c in (red, green, blue))
        shown = 0.0 if abs(effort) < 5e-3 * abs(end) and np.isfinite(end) else effort
        lines.append((f"{actuator.name}: {shown:.4g}{most} {actuator.unit}", darker))
    more = len(lines) - _MAX_EFFORT_LINES
    return lines if more <= 0 else [*lines[:_MAX_EFFORT_LINES], (f"and {more} more", INK)]


def written(image: np.ndarray, lines: Sequence[Line], foot: str = "") -> np.ndarray:
    """Return an image (height, width, 3) with lines in its upper left corner and a line at the bottom."""
    canvas = Image.fromarray(image)
    pen = ImageDraw.Draw(canvas, "RGBA")
    size = _letters_px(*image.shape[:2])
    font, gap = _font(size), round(1.25 * size)
    x = y = max(3, size // 2)
    for text, colour in lines:
        _put(pen, (x, y), text, font, colour)
        y += gap
    if foot:
        small = _font(max(_MIN_LETTERS_PX - 2, round(0.8 * size)))
        _put(pen, (x, image.shape[0] - round(1.7 * size)), foot, small, (90, 90, 90))
    return np.asarray(canvas)


def _letters_px(height: int, width: int) -> int:
    return max(_MIN_LETTERS_PX, round(min(height, 0.75 * width) / 32))


def _put(pen, place: tuple[int, int], text: str, font, colour: tuple[int, int, int]) -> None:
    box = pen.textbbox(place, text, font=font)
    pen.rectangle((box[0] - 2, box[1] - 2, box[2] + 2, box[3] + 2), fill=(255, 255, 255, 170))
    pen.text(place, text, font=font, fill=colour)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font that Matplotlib ships, the same on every machine."""
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
