"""Tables: nothing of them is lost in a pipe or on a terminal of any width, and no line is wider than the terminal."""

import io
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.studies.output.document import Facts, Table, Text, table_of
from linkplan.studies.output.terminal import drawn
from linkplan.studies.output.text import table, text_of

SEQUENCE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
WORD = st.text(st.characters(whitelist_categories=("Lu", "Ll", "Nd"), whitelist_characters="_.-"), min_size=1, max_size=50)
HEADS = st.lists(st.lists(WORD, min_size=1, max_size=4).map(" ".join), min_size=1, max_size=14)


def on_a_terminal(blocks, width: int, monkeypatch) -> str:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm")
    return SEQUENCE.sub("", drawn(io.StringIO(), blocks))


@settings(max_examples=100, deadline=None)
@given(data=st.data(), head=HEADS)
def test_no_line_of_any_table_is_wider_than_the_terminal_and_every_letter_is_there(data, head):
    cell = st.one_of(st.floats(), st.booleans(), st.none(), st.lists(WORD, min_size=1, max_size=6).map(" ".join))
    rows = data.draw(st.lists(st.lists(cell, min_size=len(head), max_size=len(head)), max_size=3))
    block = table_of("", [(title, "") for title in head], rows)
    with pytest.MonkeyPatch.context() as patch:
        shown = on_a_terminal([block], 80, patch)
    assert max(map(len, shown.splitlines())) <= 80
    wanted = "".join(text_of([block]).split())
    for letter in set("".join(head)) - {" ", "-"}:
        assert shown.count(letter) >= wanted.count(letter)


def test_a_table_in_a_pipe_is_as_wide_as_it_is():
    assert table(["O [deg]", "force B [N]"], [[1.0, 2.0]]).splitlines() == [
        "O [deg]  force B [N]",
        "-------  -----------",
        "1                  2",
    ]
    wide = table(["case", *(f"a_rather_long_quantity_{k} [kg m2]" for k in range(9))], [["first", *map(float, range(9))]])
    assert len(wide.splitlines()) == 3
    assert wide.splitlines()[2].split() == ["first", *map(str, range(9))]


def test_a_document_is_read_from_top_to_bottom():
    blocks = [
        Text(text="a verdict"),
        Facts(rows=[("label", "value with its unit")]),
        table_of("A table", ["pose", "gain [dB]", "stable"], [["O = 1 deg", 12.3456789, True], ["O = 2 deg", None, False]]),
        Text(text="something to know", tone="note"),
    ]
    assert text_of(blocks).splitlines() == [
        "a verdict",
        "label: value with its unit",
        "",
        "A table",
        "pose       gain [dB]  stable",
        "---------  ---------  ------",
        "O = 1 deg      12.35     yes",
        "O = 2 deg          -      NO",
        "",
        "note: something to know",
    ]


def test_names_of_a_model_may_have_brackets():
    found = table_of("", ["case", ("joint [left]", "deg"), "speed [deg/s]"], [])
    assert isinstance(found, Table)
    assert found.columns == [("case", ""), ("joint [left]", "deg"), ("speed", "deg/s")]
