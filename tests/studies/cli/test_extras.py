"""Commands whose optional package is missing."""

import sys

import pytest

from linkplan.models.extras import EXTRAS


@pytest.mark.parametrize(
    ("module", "arguments", "feature"),
    [
        ("pyarrow", ["experiment", "knee-reach", "--samples", "2"], "experiment"),
        ("pyarrow", ["plan", "knee-reach", "--parquet", "-o", "OUT"], "--parquet"),
        ("av", ["render", "knee-reach", "-o", "OUT.mp4"], "an .mp4"),
        ("distributed", ["experiment", "knee-reach", "--cluster", "tcp://nowhere:1"], "a cluster"),
    ],
)
def test_a_command_without_its_package_ends_in_one_line_before_it_plans(
    monkeypatch, ask, tmp_path, module, arguments, feature
):
    monkeypatch.setitem(sys.modules, module, None)
    code, out, err = ask(*(word.replace("OUT", str(tmp_path / "out")) for word in arguments))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1, err
    assert err.strip().endswith(f"pip install 'linkplan[{EXTRAS[module][1]}]'")
    assert f"{feature} needs" in err
    assert not list(tmp_path.iterdir())
