"""Images written as a file: an MP4 (H.264), an endless GIF, or a PNG. The metadata of each name linkplan."""

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from linkplan.models.errors import LinkplanError
from linkplan.models.extras import load_extra
from linkplan.planner.files.single_file import MADE_BY

# With 64 colours thin rods change their hue; with 128 a file is a tenth larger.
_PALETTE_COLOURS = 96


def write_png(path: Path, image: np.ndarray) -> None:
    """Write an image (height, width, 3) of bytes."""
    info = PngInfo()
    info.add_text("Software", MADE_BY)
    Image.fromarray(image).save(path, format="PNG", pnginfo=info, optimize=True)


def write_mp4(path: Path, images: Iterable[np.ndarray], fps: float) -> None:
    """Write images (height, width, 3) of bytes, with even height and width, at `fps` frames a second.

    Raises:
        MissingPackageError: if PyAV is not installed.
        LinkplanError: if the video library has no H.264 encoder.
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
                stream = film.add_stream(
                    "libx264", rate=rate, options={"crf": "18", "preset": "medium"}
                )  # visually lossless
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "yuv420p"  # the pixel format that browsers play
            film.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        if stream is not None:
            film.mux(stream.encode())


def write_gif(path: Path, images: Iterable[np.ndarray], n: int, fps: float, palette_from: Sequence[np.ndarray]) -> None:
    """Write n images (height, width, 3) of bytes at `fps` frames a second. A GIF counts hundredths of a second.

    There is no dithering, which would double the size.

    Args:
        path: of the file.
        images: in order.
        n: number of images.
        fps: frames a second, at most 50.
        palette_from: some of the images, from which the palette is made.
    """
    palette = _palette(palette_from)

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
        optimize=True,  # unchanged pixels are omitted from the next frame
        disposal=1,
    )


def _palette(images: Sequence[np.ndarray]) -> Image.Image:
    """Return a palette of images (height, width, 3) that keeps rare colours, such as that of a thin rod.

    Median cut alone assigns nearly all entries to the many shades of the background. Here a colour of n pixels counts as the
    cube root of n, and k-means then moves each entry to the mean of its colours.
    """
    pixels = np.concatenate([image.reshape(-1, 3) for image in images])
    cells = (pixels >> 2).astype(np.int64) @ (1 << 12, 1 << 6, 1)  # cells of 4 levels a side
    _, first, counts = np.unique(cells, return_index=True, return_counts=True)
    counted = np.repeat(pixels[first], np.ceil(np.cbrt(counts)).astype(int), axis=0)
    palette = Image.fromarray(counted[None]).quantize(
        _PALETTE_COLOURS, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE
    )
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[(colours >= 244).all(axis=1)] = 255  # the background stays white
    palette.putpalette(colours.ravel().tolist())
    return palette
