"""What is drawn: figures as they are saved, and the colours in a picture's regions."""

from pathlib import Path

import matplotlib.image
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

# A pixel has a colour where all three channels are as near as a decoded PNG's eighth bit.
_SAME = 1 / 255


def saved_figures(monkeypatch) -> dict[str, Figure]:
    """Return a dictionary that takes up every figure from here on, by the name of the file that it is saved as."""
    figures, save = {}, Figure.savefig

    def noted(figure: Figure, path: Path, *options: object, **more: object) -> None:
        save(figure, path, *options, **more)
        figures[Path(path).name] = figure

    monkeypatch.setattr(Figure, "savefig", noted)
    return figures


def curves(axes) -> dict[str, np.ndarray]:
    """Return the labelled lines of axes that hold data: (2, n), x above y."""
    drawn = [line for line in axes.lines if len(line.get_xdata()) and not str(line.get_label()).startswith("_")]
    return {str(line.get_label()): np.array(line.get_data(), dtype=float) for line in drawn}


def dots(axes) -> list[np.ndarray]:
    """Return the lines of axes that are drawn as dots: (2, n) each, x above y."""
    return [np.array(line.get_data(), dtype=float) for line in axes.lines if line.get_marker() == "o"]


def labels(figure: Figure) -> list[tuple[str, str]]:
    """Return the labels (x, y) of a figure's axes."""
    return [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]


def pixels_of(path: Path, colour: str, region: tuple[slice, slice], same: float = _SAME) -> int:
    """Return how many pixels of a picture's region (rows, columns) have a colour, each part to `same`."""
    picture = matplotlib.image.imread(path)[..., :3][region]
    return int(np.sum(np.all(np.abs(picture - np.array(to_rgb(colour))) <= same, axis=2)))
