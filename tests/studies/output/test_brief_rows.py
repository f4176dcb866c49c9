"""A summary shows the worst of many rows of a kind, and the first of many notes; `--all` prints every one."""

import pytest

from linkplan.studies.cli.main import main
from linkplan.studies.output.text import brief_rows, in_brief, notes_of

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
    (place / "carts.xml").write_text(carts)
    start, goal = (", ".join(f"x{k} = {value}" for k in range(CARTS)) for value in (0.0, 0.1))
    (place / "carts.toml").write_text(
        '[mechanism]\nmodel = "carts.xml"\n[motion]\nkind = "reach"\nduration_s = 0.5\n'
        f"start_m = {{ {start} }}\ngoal_m = {{ {goal} }}\n[objective]\nminimize = 'effort'\n"
    )
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
