"""The door for files and texts of others: no more room than they take, no more depth than is meant."""

import os
import tracemalloc

import numpy as np
import pytest

from linkplan.models import library
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.reading import parse_toml, read_file, read_head
from linkplan.models.selection import Selection
from tests.support.refusals import refusal


def test_reading_sets_aside_no_more_than_a_file_has(tmp_path):
    (tmp_path / "small").write_bytes(b"ab")
    tracemalloc.start()
    try:
        assert read_file(tmp_path / "small", "it", 500_000_000) == b"ab"
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_file_of_exactly_the_most_is_read_and_one_byte_more_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    assert read_file(tmp_path / "file", "it", 3) == b"abc"
    with pytest.raises(ProblemError, match="3 bytes; at most 2"):
        read_file(tmp_path / "file", "it", 2)


def test_a_head_of_a_long_file_is_read_without_the_rest(tmp_path):
    with (tmp_path / "long").open("wb") as file:
        file.write(b"head")
        os.truncate(file.fileno(), 10_000_000_000)
    assert read_head(tmp_path / "long", "it", 4) == b"head"


@pytest.mark.parametrize("key", ["a" + ".a" * 5000, "a" + ' . "b"' * 5000])
def test_a_key_of_thousands_of_parts_is_refused_before_the_parser_sees_it(key):
    assert "nested" in refusal(lambda: parse_toml(f"{key} = 1", "it"), ProblemError)


@pytest.mark.parametrize("text", ['x = "' + "1.5, " * 500 + '"', "x = [" + "1.5," * 500 + "]", 'x = "' + "." * 500 + '"'])
def test_points_in_values_are_no_depth(text):
    assert parse_toml(text, "it")["x"]


def test_an_old_model_s_stack_of_some_megabytes_is_read():
    old = '<mujoco><size nstack="300000"/><worldbody><body><joint name="arm"/><geom size="0.1"/></body></worldbody></mujoco>'
    assert load_mechanism(old).dof == 1


RANGED = """<mujoco>{compiler}<worldbody><body><joint name="arm" axis="0 1 0" range="-{most} 0.5"/>
<geom size=".1" pos=".3 0 0"/>
</body></worldbody><actuator><motor joint="arm"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("compiler", "most", "said"),
    [
        ("", "3.14", True),
        ('<compiler angle="degree"/>', "6.28", True),
        ("", "30", False),
        ('<compiler angle="radian"/>', "3.14", False),
        ("", "0.5", True),
    ],
)
def test_ranges_that_radians_would_explain_are_noted_where_they_are_read_in_degrees(compiler, most, said):
    notes = load_mechanism(RANGED.format(compiler=compiler, most=most)).notes
    assert any(f"ends at {float(most):g} deg: a file that means radians has" in note for note in notes) == said


def test_a_model_is_compiled_once_in_a_block_and_each_answer_is_a_copy(monkeypatch):
    compiled = []
    monkeypatch.setattr(library, "_compiled", lambda *asked, real=library._compiled: compiled.append(asked) or real(*asked))
    locked = Selection(lock={"O": 10.0})
    with library.compiled_once():
        first, again = (library.compile_model("optimus-knee")[1] for _ in range(2))
        first.eq_solref[:] = 0.5
        assert not np.any(again.eq_solref == 0.5)
        assert not np.any(library.compile_model("optimus-knee")[1].eq_solref == 0.5)
        assert library.compile_model("optimus-knee", selection=locked)[1].nv == again.nv - 1
        assert len(compiled) == 2
    library.compile_model("optimus-knee")
    assert len(compiled) == 3
