"""Tables on the terminal: never wider than 80 columns, nothing lost, and one block where that suffices."""

from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.studies.output.tables import TABLE_WIDTH, described, table

WORD = st.text(st.characters(whitelist_categories=("Lu", "Ll", "Nd"), whitelist_characters="_.-[]"), min_size=1, max_size=50)
HEADS = st.lists(st.lists(WORD, min_size=1, max_size=4).map(" ".join), min_size=1, max_size=14)


def letters(text: str) -> list[str]:
    return sorted(text.replace(" ", "").replace("\n", ""))


@settings(max_examples=100, deadline=None)
@given(data=st.data(), head=HEADS)
def test_no_line_of_any_table_exceeds_eighty_columns_and_every_head_is_there(data, head):
    cell = st.one_of(st.floats(), st.booleans(), st.none(), st.lists(WORD, min_size=1, max_size=6).map(" ".join))
    rows = data.draw(st.lists(st.lists(cell, min_size=len(head), max_size=len(head)), max_size=3))
    shown = table(head, rows)
    assert max(map(len, shown.splitlines())) <= TABLE_WIDTH
    said = letters(shown)
    for title in head:
        for letter in set(title) - {" "}:
            assert said.count(letter) >= sum(one.count(letter) for one in head)


def test_a_table_that_fits_stands_in_one_block_under_heads_of_one_line():
    assert table(["O [deg]", "force B [N]"], [[1.0, 2.0]]).splitlines() == [
        "O [deg]  force B [N]",
        "-------  -----------",
        "1                  2",
    ]


def test_heads_are_folded_before_columns_are_laid_out_in_blocks():
    head = ["O [deg]", *(f"weight alone joint_{k} [N.m]" for k in range(5))]
    shown = table(head, [[1.5] * 6])
    assert "\n\n" not in shown
    assert shown.splitlines()[-1].split() == ["1.5"] * 6
    assert len(shown.splitlines()) > 3


def test_every_block_of_a_wide_table_begins_with_the_first_column():
    shown = table(["case", *(f"a_rather_long_quantity_{k} [kg m2]" for k in range(9))], [["first", *map(float, range(9))]])
    blocks = shown.split("\n\n")
    assert len(blocks) > 1
    assert all(block.splitlines()[-1].startswith("first ") for block in blocks)
    assert [x for block in blocks for x in block.splitlines()[-1].split()[1:]] == [str(k) for k in range(9)]


def test_a_unit_is_never_folded():
    shown = table(["one two [kg m2]"] * 12, [[1.0] * 12])
    assert shown.count("[kg m2]") >= 12


def test_what_a_name_is_goes_on_below_itself():
    lines = described({"short": "x " * 60, "a-longer-name": "y"})
    assert max(map(len, lines[0].splitlines())) <= TABLE_WIDTH
    assert lines[0].splitlines()[1].startswith(" " * len("  a-longer-name  x"[:-1]))
    assert lines[1] == "  a-longer-name  y"
