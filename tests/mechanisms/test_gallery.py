"""The built-in mechanisms together: each checks clean, has a problem, and a picture that docs/mechanisms.md shows."""

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from docs.tools.draw_cut_loop import PICTURE, cut_loop_figure
from docs.tools.draw_gallery import FOLDER, SHOWN, gallery_figure
from docs.tools.draw_knee import PICTURE as SKETCH
from docs.tools.draw_knee import knee_figure
from linkplan.models.catalogue import MODELS
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.reach import reach
from linkplan.models.poses.skeleton import sticks
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.studies.check.inspection import inspect
from linkplan.studies.output.body_colours import body_colours, hex_of
from linkplan.studies.output.figure import SERIES
from tests.support.data import ROOT
from tests.support.figure_texts import text_faults
from tests.support.figures import pixels_of, saved_figures
from tests.support.mechanism_checks import mechanism_of, plan_of
from tests.support.mechanisms import replaced
from tests.support.tolerances import KNEE, relative_error
from tests.support.tolerances_planner import ROUNDING

TWO_APART = """
<mujoco>
  <worldbody>
    <body><joint name="driven" axis="0 1 0"/><geom size="0.01 0.1" type="capsule" pos="0 0 0.1"/></body>
    <body pos="1 0 0"><joint name="free" axis="0 1 0"/><geom size="0.01 0.1" type="capsule" pos="0 0 0.1"/></body>
  </worldbody>
  <actuator><motor name="motor" joint="driven" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
# Rows of a picture that its legend takes at the most, and pixels that a body's line has at the least, drawn or as a sample.
LEGEND, STROKE = 80, 40
# What is drawn [m] against the plan: it is followed in small steps, its loops closed to 1e-11 m.
DRAWN_M = 1e-6
SHOWN_IN = ROOT / "studies" / "gallery"
SOUND = [name for name in MODELS if name != "optimus-knee-source"]
every_mechanism = pytest.mark.parametrize("name", SOUND)


@pytest.mark.slow
@every_mechanism
def test_check_finds_no_fault(name):
    assert inspect(mechanism_of(name), []).problems == ()


@every_mechanism
def test_a_built_in_problem_moves_it_and_the_page_on_mechanisms_shows_its_picture(name):
    shown = [problem for problem in SHOWN if read_tables(problem)[1]["mechanism"]["model"] == name]
    assert shown, "no problem of the gallery moves it"
    assert set(shown) <= set(PROBLEMS)
    assert f"studies/gallery/{name}.png" in (ROOT / "docs" / "mechanisms.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("drawn_figures")
def test_the_drawing_of_the_cut_loop_has_the_gap_that_mujoco_finds(tmp_path):
    gap = cut_loop_figure(tmp_path / "cut.png", turned_deg=-10.0)
    mechanism = mechanism_of("optimus-knee")
    data = mujoco.MjData(mechanism.model)
    pose = mechanism.home.copy()
    pose[mechanism.independent] += np.radians(-10.0)
    data.qpos[:] = mechanism.qpos_of(pose[None])[0]
    mujoco.mj_forward(mechanism.model, data)
    tied = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert gap == pytest.approx(np.linalg.norm(data.efc_pos[tied]), rel=1e-9)
    assert (tmp_path / "cut.png").stat().st_size > 0
    assert PICTURE.is_file()


@pytest.mark.usefixtures("drawn_figures")
def test_the_sketch_of_the_knee_has_the_source_document_s_letters_and_lengths(tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    lengths = knee_figure(tmp_path / "sketch.png")
    assert lengths == pytest.approx({"crank": 0.057, "coupler": 0.0741, "rocker": 0.0855, "ground": 0.057}, abs=1e-9)
    texts = {text.get_text(): text.xy for text in saved["sketch.png"].axes[0].texts if text.get_text()}
    assert {"O", "A", "B", "C"} <= set(texts)
    for pin, other, metres in (("O", "A", 0.057), ("A", "B", 0.0741), ("C", "B", 0.0855), ("O", "C", 0.057)):
        assert np.linalg.norm(np.subtract(texts[pin], texts[other])) == pytest.approx(metres, rel=0.02), (pin, other)
    assert [fault for fault in text_faults(saved["sketch.png"]) if "lies on" in fault or "cut off" in fault] == []
    assert SKETCH.is_file()


def test_the_gallery_is_drawn_where_the_readme_looks_for_it():
    assert FOLDER == SHOWN_IN


@pytest.mark.slow
@every_mechanism
def test_the_gallery_s_picture_shows_every_body_in_its_colour_and_no_other(name):
    mechanism = mechanism_of(name)
    own = body_colours(mechanism)
    bodies = {stick.body for stick in sticks(mechanism, mechanism.home[None]) if not stick.fixed}
    colours = {hex_of(own[mechanism.model.body(body).id]): body for body in bodies}
    path, whole, drawing = SHOWN_IN / f"{name}.png", (slice(None), slice(None)), (slice(LEGEND, None), slice(None))
    unused = [one for one in SERIES if min(np.abs(np.subtract(to_rgb(one), to_rgb(own))).max() for own in colours) > 0.02]
    for colour in (*colours, *unused):
        assert (pixels_of(path, colour, whole) > STROKE) == (colour in colours), colour
        if colour in colours:
            shown = max(pixels_of(path, colour, drawing), pixels_of(path, half(colour), drawing, 1.5 / 255))
            assert shown > STROKE, colours[colour]


def half(colour: str) -> str:
    """Return the colour of a shape's filling on white paper."""
    return "#" + "".join(f"{round((int(colour[k : k + 2], 16) + 255) / 2):02x}" for k in (1, 3, 5))


@pytest.mark.slow
def test_a_gallery_s_picture_is_drawn_from_a_plan(tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    plan = plan_of("cart-pole-swing-up")
    gallery_figure(plan, tmp_path / "picture.png")
    (axes,) = saved["picture.png"].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")
    assert set(axes.get_legend_handles_labels()[1]) == {"ground", "cart", "pole"}
    last, first = plan.trajectory.position_at([plan.trajectory.duration_s, 0.0])
    own = body_colours(plan.problem.mechanism)
    shapes = {
        body: [patch.get_xy() for patch in axes.patches if to_hex(patch.get_edgecolor()) == hex_of(own[index])]
        for index, body in ((plan.problem.mechanism.model.body(name).id, name) for name in ("cart", "pole"))
    }
    carts = [0.5 * (xy[:, 0].min() + xy[:, 0].max()) for xy in shapes["cart"]]  # a box at each of nine instants
    assert len(carts) == 9
    assert [carts[0], carts[-1]] == pytest.approx([first[0], last[0]], abs=DRAWN_M)
    rod = shapes["pole"][16]  # a capsule and a ball at each instant; at the goal it stands upright on the cart
    assert 0.5 * (rod[:, 0].min() + rod[:, 0].max()) == pytest.approx(last[0], abs=DRAWN_M)
    assert np.ptp(rod[:, 1]) > 5 * np.ptp(rod[:, 0])
    assert rod[:, 1].max() > shapes["cart"][8][:, 1].max()


@pytest.mark.slow
def test_an_unactuated_joint_that_the_others_move_is_a_note_and_one_that_nothing_moves_a_fault():
    pole = inspect(mechanism_of("cart-pole"), [])
    assert any("pole" in note and "underactuated" in note for note in pole.notes)
    apart = inspect(load_mechanism(TWO_APART), [])
    assert any("joint free moves freely" in problem for problem in apart.problems)


def test_a_stop_on_a_dependent_joint_is_a_note():
    five_bar = inspect(mechanism_of("five-bar"), [])
    assert any("joint P's range [10, 170] deg stops the mechanism" in note for note in five_bar.notes)
    source = inspect(mechanism_of("optimus-knee-source"), [])
    assert any("joint A's range [-90, 90] deg stops the mechanism" in note for note in source.notes)


def test_a_rod_that_slides_in_a_barrel_is_drawn_from_the_barrel_s_pin_to_its_own_tip():
    mechanism = mechanism_of("optimus-knee-linear")
    poses = reach(mechanism).poses[::20]
    drawn = {stick.body: stick.pins for stick in sticks(mechanism, poses)}
    length = np.linalg.norm(drawn["rod"][:, -1] - drawn["rod"][:, 0], axis=1)
    assert np.ptp(length) > 0.1
    assert relative_error(length, poses[:, mechanism.independent[0]]) < KNEE


def test_a_body_on_a_single_pin_is_drawn_to_its_centre_of_mass():
    mechanism = mechanism_of("cart-pole")
    (pole,) = (stick for stick in sticks(mechanism, mechanism.home[None]) if stick.body == "pole")
    assert pole.pins[0, 1] - pole.pins[0, 0] == pytest.approx([0.0, -0.5])


def test_a_squeezer_without_its_spring_is_another_mechanism():
    """The spring is honoured: it is most of what holds the crank."""
    limp = load_mechanism(replaced(built_in_text("andrews-squeezer"), 'stiffness="4530"', 'stiffness="0"'))
    sprung = mechanism_of("andrews-squeezer")
    (q,), still = follow(sprung, np.array([[1.0]])), np.zeros(1)
    hold = [float(m.dynamics.inverse_dynamics(q, still, still)) for m in (limp, sprung)]
    assert abs(hold[0]) < ROUNDING
    assert abs(hold[1]) > 1e-3
