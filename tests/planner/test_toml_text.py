"""Tables as TOML text: what is written is read back as it was."""

import math
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import inline, toml_text

WORDS = st.text(st.characters(exclude_categories=("Cs",)), max_size=12)
NUMBERS = st.one_of(st.booleans(), st.integers(-(2**62), 2**62), st.floats(allow_nan=False))
VALUES = st.recursive(
    st.one_of(NUMBERS, WORDS),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(WORDS, inner, max_size=3)),
    max_leaves=8,
)


@given(st.dictionaries(WORDS, st.one_of(NUMBERS, WORDS, st.dictionaries(WORDS, VALUES, max_size=4)), max_size=4))
def test_any_tables_are_read_back_as_they_were(tables):
    assert tomllib.loads(toml_text(tables)) == tables


def test_not_a_number_is_written_too():
    assert math.isnan(tomllib.loads(f"x = {inline(math.nan)}")["x"])


def test_a_text_of_several_lines_keeps_its_lines():
    model = "<mujoco>\n  <worldbody/>\n</mujoco>\n"
    text = toml_text({"mechanism": {"model": model}})
    assert "\n  <worldbody/>\n" in text
    assert tomllib.loads(text)["mechanism"]["model"] == model


def test_what_toml_has_no_form_for_is_refused_by_its_key():
    with pytest.raises(ProblemError, match=r"motion\.start_deg\.O is numbers, words, lists or tables, got None"):
        toml_text({"motion": {"start_deg": {"O": None}}})
