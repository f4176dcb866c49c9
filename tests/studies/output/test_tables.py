"""Tables: as wide as a terminal has room for, and brief where many rows say the same."""

import io
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.cli.main import main
from linkplan.planner.problem.problem import Problem
from linkplan.studies.output.document import Facts, Table, Text, table_of
from linkplan.studies.output.terminal import drawn
from linkplan.studies.output.text import brief_rows, in_brief, notes_of, table, text_of

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


def test_a_zero_has_no_sign():
    assert text_of([table_of("", ["power [W]"], [[-0.0]])]).split()[-1] == "0"


CARTS = 6


@pytest.mark.parametrize("units", [["deg"] * 4 + ["m"], ["deg", "m", "deg", "m", "deg"]])
def test_rows_of_several_units_are_several_kinds(units):
    rows = [[f"room of j{k}", float(k)] for k in range(5)]
    assert brief_rows(rows, range(5), units, [f"j{k}" for k in range(5)]) is None


def test_names_count_as_whole_words():
    rows = [[f"room of {what}", 0.0] for what in ("arm", "forearm", "arm-2", "arms", "army")]
    assert brief_rows(rows, range(5), ["deg"] * 5, ["arm"]) is None


def test_the_first_note_stands_for_more_than_four_that_differ_in_names_and_numbers():
    many = [f"servo m{k} acts within {k}.5 N" for k in range(5)]
    few = [f"rod r{k} spins" for k in range(4)]
    notes = notes_of([*many, *few], [f"m{k}" for k in range(5)] + [f"r{k}" for k in range(4)])
    assert [note.text for note in notes] == [*many, *few]
    assert [note.text for note in in_brief(notes)] == [f"{many[0]} (and 4 more of this kind)", *few]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a plan for six carts on rails. Cart 2 uses the largest share of its effort limit."""
    place = tmp_path_factory.mktemp("carts")
    bodies = "".join(
        f'<body pos="0 {k} 0"><joint name="x{k}" type="slide" axis="1 0 0" range="-1 1"/><geom size=".1" mass="1"/></body>'
        for k in range(CARTS)
    )
    limits = enumerate([30, 20, 10, 20, 30, 40])
    motors = "".join(
        f'<motor name="m{k}" joint="x{k}" ctrllimited="true" ctrlrange="-{limit} {limit}"/>' for k, limit in limits
    )
    option = '<option gravity="0 0 0" timestep="0.002"/>'
    carts = f"<mujoco>{option}<worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    start, goal = ({f"x{k}": value for k in range(CARTS)} for value in (0.0, 0.1))
    problem = Problem.reach(carts, start_m=start, goal_m=goal, duration_s=0.5)
    (place / "carts.toml").write_text(problem.to_toml())
    assert main(["plan", str(place / "carts.toml"), "-o", str(place / "plan")]) == 0
    return place / "plan"


@pytest.mark.parametrize(
    ("command", "label", "of_m2"),
    [
        (["plan"], "effort m{}", "effort m2, the worst of 6: "),
        (["prove"], "planned effort of m{}", "planned effort of m2, the worst of 6 "),
        (["track", "--tracker", "pd+ff"], "m{} ", "m2, the worst of 6 "),
        (["compare", "--trackers", "pd"], "m{} ", "m2, the worst of 6 "),
    ],
)
def test_a_command_prints_the_worst_of_many_and_every_one_with_all(command, label, of_m2, folder, capsys):
    subject = str(folder.parent / "carts.toml") if command == ["plan"] else str(folder)
    call = [command[0], subject, *command[1:]]
    capsys.readouterr()
    main(call)
    brief = capsys.readouterr().out
    main([*call, "--all"])
    whole = capsys.readouterr().out
    assert of_m2 in brief
    assert "--all prints every row" in brief
    assert "--all" not in whole
    assert all(f"\n{label.format(k)}" in whole for k in range(CARTS))
    assert not any(f"\n{label.format(k)}" in brief.replace(of_m2, "") for k in range(CARTS))


def test_a_plan_is_said_in_ten_lines_of_eighty_letters(capsys):
    assert main(["plan", "knee-reach"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) < 10  # where it is saved is one more line
    assert max(map(len, lines)) <= 80
    said = ["knee-reach: optimal", "duration", "objective", "effort act_O", "least margin", "certificate: passed", "proof"]
    assert all(any(line.startswith(words) for line in lines) for words in said)
