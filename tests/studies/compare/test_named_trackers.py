"""Trackers by name: built-in, installed, and a module's own."""

import numpy as np
import pytest

from linkplan.cli.main import main
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import GainError, ProblemError
from linkplan.studies.compare.compare import compare, track
from linkplan.studies.compare.comparison_blocks import comparison_notes
from linkplan.studies.compare.user_tracker import tracker_named, trackers_loaded, users_tracker
from tests.support.bodies import body_plan
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

LAW = """
import numpy as np


class Still:
    name = "still"

    def __init__(self, reference):
        self.reference = reference

    def effort(self, k, position, velocity):
        return self.reference.effort[k]
"""


@pytest.fixture
def laws(tmp_path, monkeypatch):
    (tmp_path / "laws_of_mine.py").write_text(LAW)
    (tmp_path / "broken_laws.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("laws")
def test_a_module_s_own_tracker_runs_beside_the_built_in_ones():
    found = compare(optimal("knee-reach"), None, asked=trackers_loaded(["pd", "laws_of_mine:Still"]))
    assert list(found.nominal) == ["pd", "still"]


@pytest.mark.usefixtures("laws")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lqrr", "lqr"),
        ("no_module_of_this_name:Law", "No module named"),
        ("laws_of_mine:Sill", "has no attribute 'Sill'"),
        ("broken_laws:Law", "ZeroDivisionError"),
    ],
)
def test_a_tracker_that_cannot_be_had_is_refused_in_one_line(text, said):
    with pytest.raises(ProblemError, match=said) as refused:
        trackers_loaded([text])
    assert "\n" not in str(refused.value)


def test_a_tracker_of_an_installed_package_is_found_by_its_name(monkeypatch, tmp_path):
    """What a distribution says in its metadata is enough."""
    (tmp_path / "laws_installed.py").write_text(LAW)
    info = tmp_path / "laws-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: laws\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[linkplan.trackers]\nstill = laws_installed:Still\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert tracker_named("still").__name__ == "Still"


@pytest.mark.parametrize("asked", [lambda: None, int])
def test_a_function_that_cannot_take_a_reference_is_refused_with_what_it_raised(asked):
    assert_refused(lambda: users_tracker(asked, None, object()), "cannot be made: TypeError", kind=ProblemError)


class _Odd(BaseException):
    pass


def _raises(error: BaseException):
    def raising(*_):
        raise error

    return raising


class _Unspeakable:
    """A thing without a text and without numbers."""

    __repr__ = __str__ = __array__ = _raises(_Odd())


def _law(**members):
    """Return what makes a law that is at fault in one member."""
    return type("Faulty", (), {"name": "faulty", "effort": lambda *_: [0.0], "__init__": lambda *_: None} | members)


def _with_memory(**members):
    step = {"start": lambda _, n: np.zeros((n, 1)), "step": lambda *given: ([[0.0]], given[-1])}
    return _law(effort=None, **step | members)


FAULTY = {
    "exit": (_law(effort=_raises(SystemExit(0))), "'faulty' fails at control instant 0: SystemExit: 0"),
    "raise": (_law(effort=_raises(ZeroDivisionError("by\nzero"))), "'faulty' fails at .* 0: ZeroDivisionError: by zero"),
    "base": (_law(effort=_raises(_Odd())), "'faulty' fails at control instant 0: _Odd$"),
    "generator": (_law(effort=_raises(GeneratorExit())), "'faulty' fails at control instant 0: GeneratorExit"),
    "stop": (_law(effort=_raises(StopIteration())), "'faulty' fails at control instant 0: StopIteration"),
    "disk": (_law(effort=_raises(OSError(28, "full"))), "'faulty' fails at control instant 0: OSError: .* full"),
    "made": (_law(__init__=_raises(SystemExit(0))), "'Faulty' cannot be made: SystemExit: 0"),
    "function": (_raises(_Odd("x")), "'raising' cannot be made: _Odd: x"),
    "name": (_law(name=property(_raises(SystemExit(0)))), "'Faulty' cannot be used: SystemExit: 0"),
    "effort": (_law(effort=property(_raises(SystemExit(0)))), "'Faulty' cannot be used: SystemExit: 0"),
    "long": (_law(name="n" * 300), "'Faulty' is 'nnnn"),
    "lines": (_law(name="a\nb"), "at most 50 printable characters, .* 'Faulty' is 'a b'"),
    "nothing": (_law(effort=lambda *_: None), "'faulty' must return one effort .* got shape"),
    "complex": (_law(effort=lambda *_: np.array([1j])), r"'faulty' must return one effort .* got \[0"),
    "ragged": (_law(effort=lambda *_: [[1], [2, 3]]), r"'faulty' must return one effort .* got \[\[1\], \[2, 3\]\]"),
    "unspeakable": (_law(effort=lambda *_: _Unspeakable()), "'faulty' must return one effort .* got <_Unspeakable>"),
    "no law": (_Unspeakable(), "a tracker must be one of .* got <_Unspeakable>"),
    "start": (_with_memory(start=_raises(SystemExit(0))), "'faulty' cannot start: SystemExit: 0"),
    "step": (_with_memory(step=_raises(SystemExit(0))), "'faulty' fails at control instant 0: SystemExit: 0"),
    "pair": (_with_memory(step=lambda *_: None), "'faulty' fails at control instant 0: TypeError"),
    "memory": (_with_memory(step=lambda *_: ([[0.0]], np.zeros((1, 2)))), r"'faulty' must return .* \(1, 1\), got \(1, 2\)"),
}


@pytest.mark.parametrize(("asked", "said"), FAULTY.values(), ids=FAULTY)
def test_whatever_a_tracker_does_the_refusal_is_one_line_that_names_it(asked, said):
    with pytest.raises(ProblemError, match=said) as refused:
        track(optimal("knee-reach", "tracking.duration_s=0.005"), asked, None)
    assert "\n" not in str(refused.value)


def test_an_interrupt_inside_a_tracker_stays_one():
    with pytest.raises(KeyboardInterrupt):
        track(optimal("knee-reach", "tracking.duration_s=0.005"), _law(effort=_raises(KeyboardInterrupt())), None)


@pytest.mark.parametrize("command", ["track --tracker", "compare --trackers", "decompose --samples 2 --trackers"])
@pytest.mark.parametrize("law", ["Exits", "Raises", "ExitsLater"])
def test_a_command_whose_tracker_ends_or_raises_names_it_and_exits_with_2(command, law, tmp_path, monkeypatch, capsys):
    laws = [
        f"class {name}:\n    name = 'mine'\n    def __init__(self, reference): self.n = 0\n"
        f"    def effort(self, k, position, velocity):\n        {does}\n        return [0.0]\n"
        for name, does in (
            ("Exits", "raise SystemExit(0)"),
            ("Raises", "raise RuntimeError('lost')"),
            ("ExitsLater", "k > 5 and exit(0)"),
        )
    ]
    (tmp_path / "laws_that_end.py").write_text("\n".join(laws))
    monkeypatch.chdir(tmp_path)
    word, *options = command.split()
    assert main([word, "knee-reach", *options, f"laws_that_end:{law}", "--set", "tracking.duration_s=0.005"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "tracker 'mine' fails at control instant" in err.splitlines()[-1]


# A pendulum without a motor swings on, whatever the arm does.
PENDULUM = """<mujoco><worldbody><body><joint name="arm" axis="0 1 0" damping="0.1"/>
<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
<body pos="1 0 0"><joint name="rod" axis="0 1 0"/><inertial pos="0 0 -.3" mass="1" diaginertia=".1 .1 .1"/></body>
</worldbody><actuator><motor name="drive" joint="arm" ctrlrange="-4 4"/></actuator></mujoco>"""


def test_a_tracker_without_a_gain_is_left_out_and_named():
    ends = "start_deg = { arm = 0.0, rod = 0.0 }\ngoal_deg = { arm = 30.0, rod = 0.0 }\nduration_s = 1.0\n"
    plan = body_plan(PENDULUM, f'kind = "reach"\n{ends}')
    found = compare(plan, None)
    assert list(found.nominal) == ["pd", "pd+ff"]
    assert comparison_notes(found)[0].startswith("lqr is left out: LQR has no stabilising gain")
    assert_refused(lambda: compare(plan, None, asked=("lqr",)), "no effort stabilises", kind=GainError)


@pytest.fixture(scope="module")
def needs() -> dict:
    plan = optimal("knee-reach", "tracking.period_s=1e-3")
    return compare(plan, None, asked=TRACKERS).run_time


@pytest.mark.parametrize(
    ("name", "remembered", "stored", "operations"),
    [
        # Of one joint and one motor: two errors, two gains and their sum.
        ("pd", 0, 4, 2 + 2 + 1),
        # And the plan's effort added.
        ("pd+ff", 0, 5, 2 + 2 + 1 + 1),
        ("gs-pd+ff", 0, 5, 2 + 2 + 1 + 1),
        ("lqr", 0, 5, 2 + 2 + 1 + 1),
        # A third gain and sum; the integral's product and sum, two comparisons with the limits.
        ("lqi", 1, 6, 2 + 3 + 3 + 2 + 2),
    ],
)
def test_a_linear_law_s_needs_are_those_counted_by_hand(needs, name, remembered, stored, operations):
    found = needs[name]
    assert (found.remembered, found.stored, found.operations) == (remembered, stored, operations)
    assert found.operations_at_limit == operations


def test_what_computes_the_model_needs_more_by_orders_of_magnitude(needs):
    assert needs["ct"].operations > 100 * needs["lqr"].operations
    assert needs["mpc"].operations < needs["ct"].operations < needs["mpc"].operations_at_limit / 10
    assert needs["mpc"].remembered == 20


def test_every_tracker_s_time_is_reported_and_a_user_s_law_is_not_counted(needs):
    assert set(needs) == set(TRACKERS)
    assert all(0 < one.median_us <= one.percentile90_us for one in needs.values())

    class Idle:
        name = "idle"

        def effort(self, *_):
            return np.zeros(1)

    plan = optimal("knee-reach", "tracking.period_s=1e-3")
    found = compare(plan, None, asked=[Idle()]).run_time["idle"]
    assert found.operations is None
    assert found.stored is None
    assert found.median_us > 0
