"""Trackers of the user's own in experiments: a law for each machine, known by what it is written in, refused in one line."""

import numpy as np
import pytest

from linkplan.models.errors import LinkplanError, PlanFileError, ProblemError
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.tracker_source import source_files, source_hash
from linkplan.studies.compare.user_tracker import tracker_named
from linkplan.studies.variations.experiment import block
from linkplan.studies.variations.experiment import study as conducting
from linkplan.studies.variations.experiment.block import replay
from linkplan.studies.variations.experiment.experiment import Settings
from linkplan.studies.variations.experiment.study import RESULTS, refuse_changed_tracker, run_experiment, saved_experiment
from tests.support.plans import optimal
from tests.support.refusals import assert_refused

SHORT = "tracking.duration_s=0.005"
LAWS = """
import numpy as np
from gains_of_mine import GAIN


class Follower:
    def __init__(self, reference):
        self.reference = reference

    def law(self, k, s, v):
        reference = self.reference
        return reference.effort[k] + GAIN * (reference.position_rad[k] - s) + (reference.velocity_rad_s[k] - v)


class Integrating(Follower):
    name = "integrating"
    total = 0.0  # kept in itself, where it does not belong

    def effort(self, k, position, velocity):
        self.total += float(self.reference.position_rad[k][0] - position[0])
        if self.total > 0.0005:
            raise SystemExit("enough")
        return self.law(k, position, velocity) + 50.0 * self.total


class Batched(Follower):
    name, batched = "batched", True
    effort = Follower.law


class Remembering(Follower):
    name = "remembering"

    def start(self, n):
        return np.zeros((n, 1))

    def step(self, k, position, velocity, memory):
        memory = memory + self.reference.position_rad[k] - position
        return self.law(k, position, velocity) + 50.0 * memory, memory


class Impossible:
    def __init__(self, reference):
        raise ValueError("no gains\\nfor this plan")
"""
OWN = ("laws_of_an_experiment:Integrating", "laws_of_an_experiment:Batched", "laws_of_an_experiment:Remembering")


@pytest.fixture
def laws(tmp_path, monkeypatch):
    """The working folder, with laws and the gains that they import."""
    (tmp_path / "laws_of_an_experiment.py").write_text(LAWS)
    (tmp_path / "gains_of_mine.py").write_text("GAIN = 200.0\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def done(target, trackers=OWN, say=silent, samples=6, **how):
    plan = optimal("knee-reach", SHORT)
    settings = Settings(trackers=trackers, samples=samples)
    return run_experiment({"name": "knee-reach"}, None, lambda: plan, settings, target, say, **how)


def test_a_law_that_keeps_something_in_itself_runs_as_one_for_each_machine(laws, monkeypatch):
    said = []
    done(laws / "many")
    monkeypatch.setattr(block, "_MAX_LOG_BYTES", 1)  # one simulation at a time
    one = done(laws / "one", say=said.append)
    assert (laws / "one" / RESULTS).read_bytes() == (laws / "many" / RESULTS).read_bytes()
    assert [text for text in said if "one state at a time" in text] == [
        f"{OWN[0]} is evaluated for one state at a time, which is slower, because it has neither batched = True nor start"
        " and step"
    ]
    # The same law with its sum where it belongs, but for machines on which the first gives up.
    at = {name: one.results["tracker"] == name for name in OWN}
    finished = np.array([text is None for text in one.results["failure"][at[OWN[0]]]])
    assert 0 < finished.sum() < 6
    first, third = (one.results["rms_error_deg"][at[name]][finished] for name in (OWN[0], OWN[2]))
    assert first == pytest.approx(third, rel=1e-9)
    assert first != pytest.approx(one.results["rms_error_deg"][at[OWN[1]]][finished], rel=1e-9)
    assert {text for text in one.results["failure"] if text} == {"the tracker failed: SystemExit: enough"}


def test_a_sample_is_run_again_to_the_same_bits_while_the_law_is_the_same(laws):
    outcome = done(laws / "x", OWN[2:])
    _, said = replay(saved_experiment(laws / "x"), OWN[2], 3)
    assert said["rms_error_deg"] == outcome.results["rms_error_deg"][3]
    refuse_changed_tracker(laws / "x", OWN[2])
    (laws / "gains_of_mine.py").write_text("GAIN = 50.0\n")
    with pytest.raises(LinkplanError, match="'laws_of_an_experiment:Remembering' has changed since"):
        refuse_changed_tracker(laws / "x", OWN[2])


def test_a_law_that_was_changed_is_another_experiment_and_is_loaded_anew(laws):
    first = done(laws / "x", OWN[1:2])
    (laws / "gains_of_mine.py").write_text("GAIN = 50.0\n")
    with pytest.raises(PlanFileError, match=r"tracker_sources.laws_of_an_experiment:Batched was \w{64}, now \w{64}"):
        done(laws / "x", OWN[1:2])
    second = done(laws / "y", OWN[1:2])
    assert np.all(first.results["rms_error_deg"] != second.results["rms_error_deg"])


def test_a_law_that_is_changed_in_the_middle_ends_it_in_one_line(laws, monkeypatch):
    real = conducting.unbatched_notes

    def changing(experiment):
        (laws / "gains_of_mine.py").write_text("GAIN = 50.0\n")
        return real(experiment)

    monkeypatch.setattr(conducting, "unbatched_notes", changing)
    assert_refused(lambda: done(laws / "x", OWN[1:2]), "has changed since the experiment began")


def test_what_a_tracker_is_written_in_are_its_own_files(laws):
    assert sorted(source_files("laws_of_an_experiment")) == ["gains_of_mine", "laws_of_an_experiment"]
    (laws / "package_of_laws").mkdir()
    (laws / "package_of_laws" / "__init__.py").write_text("")
    (laws / "package_of_laws" / "law.py").write_text("from . import gain\nfrom .tools.more import x\nimport numpy\n")
    (laws / "package_of_laws" / "gain.py").write_text("GAIN = 1\n")
    found = source_files("package_of_laws.law")
    assert sorted(found) == ["package_of_laws", "package_of_laws.gain", "package_of_laws.law"]
    before = source_hash("package_of_laws.law:Law")
    (laws / "package_of_laws" / "gain.py").write_text("GAIN = 2\n")
    assert source_hash("package_of_laws.law:Law") != before


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("laws_of_an_experiment:Impossible", "cannot be made: ValueError: no gains for this plan"),
        ("laws_of_an_experiment:Missing", "cannot be loaded: AttributeError"),
        ("laws_of_an_experiment:np", "a tracker must be one of"),
        ("no_such_module:Law", "Python does not find the module"),
        ("pdd", "unknown tracker 'pdd' (did you mean 'pd'"),
    ],
)
def test_a_tracker_that_cannot_be_had_is_one_line_before_any_sample_runs(laws, name, said):
    assert_refused(lambda: done(laws / "x", ("pd", name)), said, kind=ProblemError)
    assert not (laws / "x").exists()


def test_a_law_with_a_memory_is_tracked_alone_too(laws):
    del laws
    assert tracker_named(OWN[2]).__name__ == "Remembering"
