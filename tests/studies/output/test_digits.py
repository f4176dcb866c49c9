"""Digits, directions and names of pins in texts and figures."""

import itertools
import types
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from msgspec import structs

import linkplan
from linkplan.models.errors import shortened
from linkplan.planner.plan.verdict import Verdict
from linkplan.studies.output.draw_bodies import draw_poses
from linkplan.studies.output.numbers import direction_name
from linkplan.studies.output.plan_blocks import figure, objective_digits, objective_unit, plan_blocks, radius_figure
from linkplan.studies.output.text import text_of
from linkplan.studies.variations.experiment.sensitivity import _named
from tests.support.plans import optimal, problem_of


@pytest.mark.parametrize(("error_deg", "digits"), [(1e-9, 8), (1e-4, 6), (1e-2, 4), (5.0, 3)])
def test_a_plan_s_figures_have_the_digits_that_its_integration_leaves_of_its_motion(error_deg, digits):
    plan = optimal("knee-reach")  # over 105.34 deg
    worse = replace(plan, certificate=structs.replace(plan.certificate, integration_error_deg=error_deg))
    assert objective_digits(worse) == digits
    said = next(line for line in text_of(plan_blocks(worse)).splitlines() if line.startswith("objective")).split()[2]
    assert said == f"{plan.objective:.{digits}g}"


def test_errors_have_two_digits_and_rounding_none():
    assert figure(1.2345e-6, 2) == "1.2e-06"
    assert figure(3e-17, 2) == "< 1e-14"
    assert figure(0.0, 2) == "0"
    assert figure(float(np.float64(0.25)), 2) == "0.25"


def test_every_effort_and_limit_has_its_unit():
    lines = [line for line in text_of(plan_blocks(optimal("knee-reach"))).splitlines() if line.startswith("effort act_O")]
    assert len(lines) == 1
    assert lines[0].count("N.m") == 2


@pytest.mark.parametrize(
    ("radius", "said"),
    [(0.97936, "0.9794"), (1 - 2.31e-5, "1-2.3e-05"), (1 + 4e-7, "1+4.0e-07"), (9.864, "9.864"), (1.0, "1")],
)
def test_a_pole_next_to_the_unit_circle_is_said_by_its_distance_from_it(radius, said):
    assert radius_figure(radius) == said


@pytest.mark.parametrize(
    ("name", "overrides", "unit"),
    [
        ("knee-reach", [], " N2 m2 s"),
        ("knee-linear-reach", [], " N2 s"),
        ("knee-linear-reach", ["objective.minimize=effort_rate"], " N2 / s"),
        ("knee-sine", [], " rad2 s"),
        ("knee-sprint", [], " s"),
        ("knee-reach", ["objective.minimize={ time = 1.0, effort = 1e-5 }", "motion.duration_s=free"], ""),
    ],
)
def test_an_objective_has_the_unit_of_what_its_actuators_give(name, overrides, unit):
    assert objective_unit(problem_of(name, *overrides)) == unit


@pytest.mark.parametrize(
    ("direction", "name"),
    [
        ((1.0, 0.0, 0.0), "x"),
        ((0.0, 0.0, -1.0), "-z"),
        ((0.6, 0.8, 0.0), "along (0.6, 0.8, 0)"),
        ((0.6, 0.8, -4.3e-19), "along (0.6, 0.8, 0)"),
    ],
)
def test_a_direction_is_an_axis_of_the_world_or_its_components_without_rounding(direction, name):
    assert direction_name(np.array(direction)) == name


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


@pytest.mark.parametrize(("left", "said"), [(-5e-8, "0 deg"), (2.5, "2.5 deg"), (-0.1, "-0.1 deg")])
def test_a_limit_that_holds_but_for_rounding_leaves_nothing_and_not_less(left, said):
    plan = optimal("knee-reach")
    near = [
        structs.replace(one, left=left, slack=1e-6) if one.what == "position" else one for one in plan.certificate.margins
    ]
    worse = replace(plan, certificate=structs.replace(plan.certificate, margins=tuple(near)))
    line = next(one for one in text_of(plan_blocks(worse)).splitlines() if one.startswith("least margin besides efforts"))
    assert line.startswith(f"least margin besides efforts: {said} to the range of ")


@pytest.mark.parametrize(
    ("ends", "said"), [((0.99983, 1.00012), "0.99983 to 1.00012"), ((0.9, 1.1), "0.9 to 1.1"), ((0.0, 2.0), "0 to 2")]
)
def test_the_label_of_an_imperfection_shows_its_whole_range(ends, said):
    study = types.SimpleNamespace(imperfections={"mass": types.SimpleNamespace(unit="kg", range=ends)})
    assert _named(study, "mass") == f"mass, {said} kg"


def test_a_sentence_is_cut_between_words():
    text = "the loops close, and the motor holds the pose"
    assert shortened(text, 100) == text
    for most in range(12, len(text)):
        cut = shortened(text, most)
        assert len(cut) <= most
        assert text.startswith(cut.removesuffix(" ..."))
        assert text[len(cut.removesuffix(" ...")) :][0] in " ,"


def test_a_sum_of_objectives_is_named_after_the_motion():
    verdict = Verdict(kind="optimal", words="motion of 0.1 s", objective="time + 1e-05 peak_effort")
    assert verdict.sentence == "locally optimal motion of 0.1 s, for time + 1e-05 peak effort"
    assert verdict.replace(objective="effort_rate").sentence == "locally effort-rate-optimal motion of 0.1 s"
