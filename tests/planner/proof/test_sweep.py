"""A claim's marks and verdict, and the sweep over boxes that decides it."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from flint import arb, ctx

from linkplan.models.deadline import NO_DEADLINE
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.limits.efforts import share_of
from linkplan.planner.proof import prove
from linkplan.planner.proof.branch import newton
from linkplan.planner.proof.claims import Claim, Record, finding_of_claim, undecided_reason
from linkplan.planner.proof.motion import Piece
from linkplan.planner.proof.prove import _Anchor, _Box, _boxes, _closure_findings, _linked, _Sweep
from linkplan.planner.proof.taylor import Verdict
from linkplan.planner.proof.walk import Blocks, blocks_of
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.motions import motion_along
from tests.support.random_motions import motion_of


@pytest.mark.parametrize("halvings", [0, 1, 3])
def test_an_interval_s_boxes_cover_it_in_order_from_the_last_of_the_list(halvings):
    boxes = _boxes(halvings, [4, 5])[::-1]
    assert len(boxes) == 2**halvings
    assert boxes[0].centre - boxes[0].radius == 0.0
    assert boxes[-1].centre + boxes[-1].radius == 1.0
    assert all(a.centre + a.radius == b.centre - b.radius for a, b in itertools.pairwise(boxes))
    assert {(box.halvings, *box.claims) for box in boxes} == {(halvings, 4, 5)}


def test_halves_of_a_box_lie_side_by_side_in_it_the_first_one_last():
    box = _Box(centre=0.375, radius=0.125, halvings=2, claims=[1, 2])
    second, first = box.halves([2])
    assert (first.centre - first.radius, first.centre + first.radius) == (0.25, 0.375)
    assert (second.centre - second.radius, second.centre + second.radius) == (0.375, 0.5)
    assert {(one.halvings, *one.claims) for one in (first, second)} == {(3, 2)}


@pytest.mark.parametrize(
    ("begin", "end", "tau", "linked"),
    [
        (arb(0.1), arb(9), 0.0, True),  # the box begins in the region of the one before
        (arb(2), arb(0.5), 0.5, True),  # the one before ends in the box's region, next to it
        (arb(2), arb(0.5), 0.4, False),  # not next to it
        (arb(2), arb(9), 0.5, False),
        (arb(0.95, 0.1), arb(9), 0.5, False),  # partly outside
    ],
)
def test_a_box_is_linked_to_the_one_before_by_the_region_of_either(begin, end, tau, linked):
    anchor = _Anchor(region=[arb(0, 1)], end=[end], z=np.zeros(1), slope=np.zeros(1), tau=tau)
    box = _Box(centre=0.75, radius=0.25, halvings=0, claims=[])
    assert _linked(anchor, [arb(0, 1)], [begin], box) is linked


@pytest.mark.parametrize(
    ("gap", "undecided", "answer"), [(0.9e-6, [], "proved"), (1.1e-6, [], "refuted"), (0.9e-6, [(0.25, 0.5)], "undecided")]
)
def test_the_loops_close_where_the_start_pose_is_a_millionth_from_the_closed_one(five_bar, gap, undecided, answer):
    sweep = replace(sweep_of(*five_bar), closure=Record(boxes=7, undecided=undecided), start_gap=gap)
    (found,) = _closure_findings(sweep)
    assert (found.answer, found.boxes) == (answer, 7)
    if answer == "proved":
        assert found.margin == pytest.approx(1e-6 - gap)
    assert _closure_findings(replace(sweep, blocks=blocks_of(load_mechanism(HINGE)))) == []


def test_what_is_left_open_on_a_box_is_told_with_the_box_s_instants():
    """The box from a quarter to three quarters of an interval of two seconds that begins after one."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    motion = motion_along([0.0, 1.0, 3.0], np.zeros((2, 2, 1)))
    sweep = sweep_of(problem, motion, blocks_of(problem.mechanism))
    sweep.records = [Record(), Record()]
    box = _Box(centre=0.5, radius=0.25, halvings=1, claims=[0, 1])
    piece = Piece.of(motion, 1)
    sweep._leave(piece, box, [1], closed=True)
    assert (sweep.records[0].undecided, sweep.records[1].undecided) == ([], [(1.5, 2.5)])
    assert sweep.closure.undecided == []
    sweep._leave(piece, box, [], closed=False)
    assert sweep.closure.undecided == [(1.5, 2.5)]


@pytest.fixture
def five_bar():
    """Return a problem, a random motion and the blocks of a five-bar; balls have 100 bits in the test."""
    ctx.prec = 100
    problem, motion = motion_of(load_mechanism("five-bar"), np.random.default_rng(3))
    return problem, motion, blocks_of(problem.mechanism)


def sweep_of(problem, motion, blocks) -> _Sweep:
    return _Sweep(problem=problem, trajectory=motion, blocks=blocks, claims=[], until=NO_DEADLINE, order=6)


def test_the_next_box_s_branch_is_guessed_along_its_slope(five_bar, monkeypatch):
    """From the end of one box to the middle of the next the guess is off by the second order of the way only."""
    guesses = []

    def noting(blocks: Blocks, s: np.ndarray, guess: np.ndarray) -> np.ndarray:
        guesses.append((guess, newton(blocks, s, guess)))
        return guesses[-1][1]

    monkeypatch.setattr(prove, "newton", noting)
    problem, motion, blocks = five_bar
    sweep = sweep_of(problem, motion, blocks)
    sweep.slack = [arb(0)] * 2
    piece = Piece.of(motion, 1)
    z = motion.start_pose[list(blocks.dependent)]
    anchor = _Anchor(region=None, end=[], z=z, slope=np.zeros_like(z), tau=0.0)
    _, anchor = sweep._states(piece, _Box(centre=0.49, radius=0.01, halvings=0, claims=[]), anchor)
    sweep._states(piece, _Box(centre=0.51, radius=0.01, halvings=0, claims=[]), anchor)
    guess, found = guesses[-1]
    way = np.abs(found - anchor.z).max()
    assert way > 1e-4
    assert np.abs(guess - found).max() < 0.2 * way


def test_a_loop_that_stands_still_is_linked_over_the_last_digits_of_its_coordinates(five_bar):
    problem, motion, blocks = five_bar
    pose = np.array(motion.start_pose)
    s, n = pose[list(blocks.independent)], len(motion.breaks_s) - 1
    pose[list(blocks.dependent)] = newton(blocks, s, pose[list(blocks.dependent)])
    at_rest = np.broadcast_to(s, (2, n, 2)) + 8 * np.spacing(s) * (np.arange(n) % 2)[:, None]
    still = replace(motion, position=at_rest, velocity=np.zeros((1, n, 2)), start_pose=pose)
    sweep = sweep_of(problem, still, blocks)
    sweep.run()
    assert sweep.closure.undecided == []
    assert sweep.boxes == n


def claim(low: float = -2.0, high: float = 5.0, slack: tuple[float, float] = (0.25, 0.5), per_unit: float = 1.0) -> Claim:
    return Claim(name="q", unit="N", bounds=(low, high), slack=slack, values=lambda _: [], per_unit=per_unit)


def bound(least: float, greatest: float, answer: bool | None = True) -> Verdict:
    return Verdict(answer=answer, least=least, greatest=greatest)


def test_a_claim_s_marks_are_its_limits_moved_outwards_by_its_allowances():
    assert claim().marks == (-2.25, 5.5)
    assert share_of((-2.0, 5.0), 0.1) == pytest.approx((0.2, 0.5))
    assert share_of((0.0, 5.0), 0.1) == pytest.approx((0.5, 0.5))


def test_a_record_has_the_widest_range_and_its_instants():
    record = Record()
    for k, (least, greatest) in enumerate([(0.0, 1.0), (0.5, 3.0), (-1.0, 2.0), (0.1, 0.2)]):
        record.add(bound(least, greatest), float(k))
    assert (record.least, record.least_at, record.greatest, record.greatest_at) == (-1.0, 2.0, 3.0, 1.0)


@pytest.mark.parametrize(
    ("least", "greatest", "end", "mark", "margin", "when"),
    [(-1.0, 5.2, 5.2, 5.5, 0.3, 7.0), (-2.0, 5.2, -2.0, -2.25, 0.25, 3.0), (-2.25, 0.0, -2.25, -2.25, 0.0, 3.0)],
)
def test_a_proved_claim_is_told_at_the_end_that_is_nearer_to_its_mark(least, greatest, end, mark, margin, when):
    record = Record(least=least, least_at=3.0, greatest=greatest, greatest_at=7.0, boxes=4)
    found = finding_of_claim(claim(per_unit=10.0), record)
    assert (found.answer, found.boxes, found.time_s, found.reason) == ("proved", 4, when, "")
    assert (found.bound, found.mark, found.margin) == pytest.approx((10 * end, 10 * mark, 10 * margin))


@pytest.mark.parametrize(
    ("least", "greatest", "value", "mark"), [(5.75, 6.0, 5.75, 5.5), (-3.0, -2.5, -2.5, -2.25), (-9.0, -8.0, -8.0, -2.25)]
)
def test_a_refuted_claim_is_told_by_the_value_that_is_surely_beyond(least, greatest, value, mark):
    record = Record(refuted=bound(least, greatest, False), refuted_at=0.125)
    found = finding_of_claim(claim(per_unit=2.0), record)
    assert (found.answer, found.time_s) == ("refuted", 0.125)
    assert (found.bound, found.mark, found.margin) == pytest.approx((2 * value, 2 * mark, -2 * abs(value - mark)))
    assert found.reason == f"{2 * value:g} N at t = 0.125 s, beyond {2 * mark:g}"


def test_undecided_boxes_are_counted():
    assert undecided_reason([(0.25, 0.5)]) == "not decided between t = 0.25 s and 0.5 s"
    assert undecided_reason([(0.25, 0.5), (1, 2), (3, 4)]).endswith("and in 2 more boxes")
    assert undecided_reason([(0.25, 0.5), (1, 2)]).endswith("and in 1 more boxes")
    assert finding_of_claim(claim(), Record(undecided=[(0.25, 0.5)], least=0.0, greatest=math.pi)).answer == "undecided"
