"""The names of pins in drawings: where there are many, none covers another."""

import itertools

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

import linkplan
from linkplan.studies.output.draw_bodies import draw_poses

pytestmark = pytest.mark.usefixtures("drawn_figures")


@pytest.mark.parametrize("size_in", [(5.0, 3.0), (8.0, 6.0)])
def test_names_of_many_pins_stand_apart_and_in_the_order_of_the_pins_heights(size_in):
    mechanism = linkplan.load_mechanism("andrews-squeezer")
    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots()
    draw_poses(axes, mechanism, mechanism.home[None])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [Text.get_window_extent(name, canvas.get_renderer()) for name in axes.texts]  # without the leading lines
    assert len(boxes) == 7
    assert not [pair for pair in itertools.combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    pins = sorted((name.xy[1], box.y0) for name, box in zip(axes.texts, boxes, strict=True))
    assert [y for _, y in pins] == sorted(y for _, y in pins)
    assert all(box.x1 <= figure.bbox.x1 for box in boxes)
