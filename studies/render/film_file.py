"""Images written as a file: an MP4 (H.264), a GIF that goes on for ever, or a PNG. Each says that linkplan made it."""

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from linkplan.models.errors import LinkplanError
from linkplan.models.extras import load_extra
from linkplan.planner.files.whole_file import MADE_BY

# H.264's constant rate factor: smaller is better and larger; 18 is told from the original by nobody.
_QUALITY = "18"
# Colours of a GIF, found in some of its frames: flat surfaces need no more, and dithering would double its size.
_COLOURS = 64
_WHITE = 244  # what is as light as this in all channels is white


def write_png(path: Path, image: np.ndarray) -> None:
    """Write an image (height, width, 3) of bytes."""
    info = PngInfo()
    info.add_text("Software", MADE_BY)
    Image.fromarray(image).save(path, format="PNG", pnginfo=info, optimize=True)


def write_mp4(path: Path, images: Iterable[np.ndarray], fps: float) -> None:
    """Write images (height, width, 3) of bytes, even in height and width, at so many a second.

    Raises:
        MissingPackageError: when PyAV is not installed.
        LinkplanError: where the video library has no H.264 encoder.
    """
    av = load_extra("av", "an .mp4")

    try:
        av.codec.Codec("libx264", "w")
    except ValueError as error:
        raise LinkplanError("this build of PyAV has no H.264 encoder (libx264); write a .gif") from error
    rate = Fraction(fps).limit_denominator(1001)
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as film:
        film.metadata["comment"] = MADE_BY
        stream = None
        for image in images:
            if stream is None:
                stream = film.add_stream("libx264", rate=rate, options={"crf": _QUALITY, "preset": "medium"})
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "yuv420p"  # what browsers and slides play
            film.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        if stream is not None:
            film.mux(stream.encode())


def write_gif(path: Path, images: Iterable[np.ndarray], n: int, fps: float, palette_from: Sequence[np.ndarray]) -> None:
    """Write n images (height, width, 3) of bytes at so many a second; a GIF counts time in hundredths.

    Args:
        path: of the file.
        images: in order.
        n: how many.
        fps: frames a second, fewer than 50.
        palette_from: some of the images, whose colours are the GIF's.
    """
    samples = Image.fromarray(np.vstack(list(palette_from)))
    palette = samples.quantize(_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[(colours >= _WHITE).all(axis=1)] = 255  # what is drawn on stays white
    palette.putpalette(colours.ravel().tolist())

    def coloured() -> Iterator[Image.Image]:
        for image in images:
            yield Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE)

    frames = coloured()
    first = next(frames)
    ends = np.round(100.0 / fps * np.arange(n + 1)).astype(int)
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames,
        duration=[10 * int(one) for one in np.diff(ends)],
        loop=0,
        comment=MADE_BY.encode(),
        optimize=True,  # what stays as it was is left out of the next frame
        disposal=1,
    )
