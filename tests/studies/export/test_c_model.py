"""A mechanism in C against Python on ten thousand random states: double to rounding, float to the bound that is stated."""

import ctypes
import functools
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from linkplan.cli.main import main
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import advance, follow
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.studies.handover.export import c_files
from linkplan.studies.handover.export.c_files import in_single_precision, operations, write_model
from linkplan.studies.handover.export.c_model import ModelCode, header_text, model_code, random_states
from linkplan.studies.handover.export.c_text import function_of, identifier
from linkplan.studies.handover.export.export import checked_outputs
from linkplan.studies.handover.export.output_joints import with_outputs
from linkplan.studies.output.text import text_of
from tests.support import parallel_ankle
from tests.support.compiled import called, library, needs_gcc, symbols
from tests.support.cortex import needs_cortex, run_on_cortex
from tests.support.pages import blocks

# C against CasADi, relative to the largest value: rounding in another order. Measured 3e-15.
C_DOUBLE = 1e-12
STATES = 10_000
BIPED_PAGE = Path(__file__).parents[3] / "docs" / "serial-equivalent.md"


@functools.cache
def exported(name: str) -> tuple[ModelCode, Path, dict]:
    """Return a mechanism's code, the folder that it is written in, and its costs."""
    code = model_code(load_mechanism(parallel_ankle.ankle_text() if name == "parallel-ankle" else name))
    folder = Path(tempfile.mkdtemp())
    return code, folder, write_model(code, folder, compiled=name == "optimus-knee")


def in_python(function: ca.Function, arguments: list[np.ndarray]) -> list[np.ndarray]:
    """Return the outputs (n, size) of a CasADi function, columns first."""
    n = len(arguments[0])
    found = function.map(n)(*[a.T for a in arguments])
    found = [found] if function.n_out() == 1 else list(found)
    shaped = [np.array(x).reshape(function.size1_out(k), n, -1) for k, x in enumerate(found)]
    return [x.transpose(1, 2, 0).reshape(n, -1) for x in shaped]


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize("single", [False, True], ids=["double", "float"])
@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "parallel-ankle"])
def test_c_is_python_on_ten_thousand_random_states(name, single):
    code, folder, record = exported(name)
    compiled = library(folder, code.prefix, single=single)
    states = random_states(code.mechanism, STATES, seed=11)
    stated = {row.function: row.float_error for row in record.functions}
    for one in code.interface:
        arguments = [states[key] for key in one.inputs]
        sizes = [one.function.numel_out(k) for k in range(one.function.n_out())]
        found = called(getattr(compiled, one.name), arguments, sizes, single=single)
        for wanted, values in zip(in_python(one.function, arguments), found, strict=True):
            off = np.abs(values - wanted).max() / (np.abs(wanted).max() or 1.0)
            assert off <= (stated[one.name] if single else C_DOUBLE), one.name


@needs_gcc
@pytest.mark.parametrize("name", ["optimus-knee", "slider-crank"])
def test_c_closes_the_loops_from_the_last_answer_and_says_how_well(name):
    code, folder, _ = exported(name)
    mechanism = code.mechanism
    path = mechanism.home[mechanism.independent] + 0.3 * np.sin(np.linspace(0, 2 * np.pi, 200))[:, None]
    close = library(folder, code.prefix)[f"{code.prefix}_close"]
    q, poses = np.array(mechanism.home), []
    for s in path:
        assert closed_in_c(close, s, q) == 0
        poses.append(q.copy())
    assert np.ptp(poses, axis=0).max() > 0.3
    assert np.abs(np.array(poses) - follow(mechanism, path)).max() < 1e-12


def closed_in_c(close, s: np.ndarray, q: np.ndarray) -> int:
    """Return the status of C's `close` at positions s; it writes the pose into q."""
    s = np.array(s, dtype=q.dtype)
    return close(ctypes.c_void_p(s.ctypes.data), ctypes.c_void_p(q.ctypes.data))


@needs_gcc
@pytest.mark.parametrize("single", [False, True], ids=["double", "float"])
@pytest.mark.parametrize("name", ["optimus-knee", "five-bar"])
def test_one_call_of_c_closes_from_home_what_continuation_reaches_and_nothing_else(name, single):
    code, folder, _ = exported(name)
    mechanism, near = code.mechanism, 1e-3 if single else 1e-10
    close = library(folder, code.prefix, single=single)[f"{code.prefix}_close"]
    home = mechanism.home[mechanism.independent]
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.independent_joints])
    low, high = np.where(np.isfinite(ranges), ranges, home[:, None] + np.array([-2.5, 2.5])).T
    reached = []
    for s in np.random.default_rng(5).uniform(low, high, (60, mechanism.dof)):
        wanted, arrives = advance(mechanism, mechanism.home, s)
        q = np.array(mechanism.home, dtype=np.float32 if single else float)
        before, status = q.copy(), closed_in_c(close, s, q)
        reached.append(arrives)
        assert status == (0 if arrives else 2)
        assert np.abs(q - (wanted if arrives else before)).max() < near
    assert 0 < np.mean(reached) < 1


@needs_gcc
@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "cart-pole"])
def test_c_refuses_to_close_at_what_is_not_finite_and_leaves_the_pose_as_it_was(name):
    code, folder, _ = exported(name)
    mechanism = code.mechanism
    close = library(folder, code.prefix)[f"{code.prefix}_close"]
    for bad in (np.nan, np.inf, -np.inf):
        for k in range(mechanism.dof):
            s, q = mechanism.home[mechanism.independent].copy(), np.array(mechanism.home)
            s[k] = bad
            assert closed_in_c(close, s, q) == 1
            assert np.array_equal(q, mechanism.home)
        for k in range(mechanism.n_q):
            q = np.array(mechanism.home)
            q[k] = bad
            assert closed_in_c(close, mechanism.home[mechanism.independent], q) == 1
            assert np.isnan(q[k]) or q[k] == bad


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar"])
def test_every_sine_and_cosine_of_a_function_is_computed_once(name):
    for one in exported(name)[0].functions:
        called_at = re.findall(r"(a\d+)=MATH\((sin|cos)\)\((a\d+)\)", one.definition("real"))
        angles = {joint.name for joint in exported(name)[0].mechanism.joints if joint.kind == "hinge"}
        assert len(called_at) <= 2 * len(angles), one.name


def test_the_header_has_the_limits_and_the_model_s_hash():
    code, _, record = exported("optimus-knee")
    text = header_text(code, [])
    joint, upper = code.mechanism.joints[0], code.prefix.upper()
    for macro, value in (("Q0_MIN", joint.lower), ("Q0_MAX", joint.upper), ("U0_MIN", -100.0), ("U0_MAX", 100.0)):
        (found,) = re.findall(rf"#define {upper}_{macro} \((.*)\)", text)
        assert float(found) == np.clip(value, -1e30, 1e30)
    assert f'#define {upper}_MODEL_HASH "{code.mechanism.fingerprint()}"' in text
    assert record.model_hash == code.mechanism.fingerprint()


@needs_gcc
def test_nothing_is_called_but_mathematical_functions():
    for name in ("optimus-knee", "five-bar"):
        code, folder, _ = exported(name)
        called_names = {line.split()[-1] for line in symbols(folder, code.prefix).splitlines()}
        assert called_names <= {"sin", "cos", "sincos", "sqrt", "tanh", "_GLOBAL_OFFSET_TABLE_"}


@needs_gcc
@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
@pytest.mark.slow
def test_cmake_builds_both_precisions_and_their_tests_pass(tmp_path):
    _, folder, _ = exported("slider-crank")
    subprocess.run(["cmake", "-S", str(folder), "-B", str(tmp_path)], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(tmp_path)], check=True, capture_output=True)
    said = subprocess.run(["ctest"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert "100% tests passed, 0 tests failed out of 2" in said


@needs_gcc
def test_the_test_vector_notices_a_wrong_sign(tmp_path):
    code, folder, _ = exported("slider-crank")
    words = ["gcc", "-std=c99", "-I", str(tmp_path), "-o", str(tmp_path / "t")]
    for name, change in (("right", False), ("wrong", True)):
        for path in folder.glob("*.[ch]"):
            text = path.read_text()
            if change and path.name == f"{code.prefix}.c":
                before, after = text.split(f"{code.prefix}_reduced_inertia", 1)
                text = before + f"{code.prefix}_reduced_inertia" + after.replace("inertia[0]=", "inertia[0]=-", 1)
            (tmp_path / path.name).write_text(text)
        sources = [str(tmp_path / f"{code.prefix}{end}.c") for end in ("", "_test")]
        subprocess.run([*words, *sources, "-lm"], check=True)
        run = subprocess.run([str(tmp_path / "t")], capture_output=True, text=True, check=False)
        assert (run.returncode, "inertia is off" in run.stdout) == ((1, True) if change else (0, False)), name


@needs_cortex
@pytest.mark.slow
@pytest.mark.parametrize("single", [False, True], ids=["double", "float"])
def test_the_test_vector_passes_on_a_cortex_m4(single, tmp_path):
    code, folder, record = exported("optimus-knee")
    assert "as in Python" in run_on_cortex(folder, code.prefix, tmp_path, single=single)
    assert any(row.compiler.startswith("arm") and row.flash_bytes > 1000 for row in record.sizes)


def test_code_of_a_whole_robot_is_written_and_not_measured(monkeypatch, tmp_path):
    code, _, _ = exported("optimus-knee")
    monkeypatch.setattr(c_files, "MOST_MEASURED_OPERATIONS", 100)
    record = write_model(code, tmp_path)
    assert record.sizes == []
    assert "use the option sizes to measure it" in text_of(record.blocks())


@needs_gcc
def test_long_derivatives_may_be_left_out_and_are_then_not_measured(monkeypatch, tmp_path):
    code, _, whole = exported("optimus-knee")
    others = [row for row in whole.functions if not row.function.endswith("derivatives")]
    monkeypatch.setattr(c_files, "MOST_MEASURED_OPERATIONS", sum(sum(row.operations.values()) for row in others))
    monkeypatch.setattr(c_files, "COMPILERS", {"gcc": ["-O2"]})
    record = write_model(code, tmp_path)
    assert record.sizes_without == ["linkplan_optimus_knee_inverse_dynamics_derivatives"]
    assert whole.sizes_without == []
    assert record.sizes[0].flash_bytes < 0.8 * whole.sizes[0].flash_bytes
    assert "without linkplan_optimus_knee_inverse_dynamics_derivatives" in text_of(record.blocks())


def test_a_model_in_the_coordinates_of_its_output_joints(tmp_path, monkeypatch):
    monkeypatch.setattr(c_files, "COMPILERS", {})
    assert main(["export", "optimus-knee", "--to", "c", "--joints", "C", "-o", str(tmp_path / "c")]) == 0
    header = (tmp_path / "c" / "linkplan_optimus_knee.h").read_text()
    assert "s[0] C [rad]" in header
    record = json.loads((tmp_path / "c" / "export.json").read_text())
    (row,) = [row for row in record["functions"] if row["function"].endswith("_transmission")]
    assert row["operations"]["multiplications"] > 10  # the linkage's G, not the motor's


def test_spins_of_rods_are_named_and_are_no_output_joints(tmp_path):
    (text,) = [block.text for block in blocks(BIPED_PAGE) if block.marks.get("file") == "biped.xml"]
    (tmp_path / "biped.xml").write_text(text)
    table = {"model": str(tmp_path / "biped.xml"), "keep": ["left/ankle"], "fix_base": True}
    toes = ["left/toe-pitch", "left/toe-roll"]
    mechanism = with_outputs(mechanism_from_tables({"mechanism": table}), toes)
    code = model_code(mechanism)
    header = header_text(code, [])
    assert header.count("spins freely") == 2
    assert "s[3] left/toe-roll [rad], effort [N.m]\n" in header
    assert checked_outputs(mechanism, toes) is mechanism
    with pytest.raises(ProblemError, match=r"joints must be 2.*got 1; left/toe-roll would be omitted"):
        checked_outputs(mechanism, toes[:1])


def test_operations_are_counted_and_carried_out_in_single_precision():
    x = ca.SX.sym("x", 2)
    y = ca.sin(x[0]) * x[1] / (x[0] + 2) + ca.if_else(x[1] > 0, ca.sqrt(x[0]), ca.fabs(x[1]))
    one = function_of("f", "", [("x", x)], [("y", y)])
    counted = operations(one.function)
    assert counted["sines and cosines"] == counted["divisions"] == counted["square roots"] == 1
    points = np.random.default_rng(0).uniform([0.1, -1], [2, 1], (500, 2))
    exact = np.array(one.function.map(500)(points.T))[0]
    (single,) = in_single_precision(one.function, points)
    off = np.abs(single[:, 0] - exact).max()
    assert 1e-9 < off < 1e-6


@pytest.mark.parametrize(
    ("name", "found"), [("a-b c", "a_b_c"), ("3rd leg", "3rd_leg"), ("__a__b", "a_b"), ("ünï", "uni"), ("膝", "bbd7883e")]
)
def test_names_become_identifiers(name, found):
    assert identifier(name) == f"linkplan_{found}"


# Targets of CMake's own, headers of C's, keywords, and names that are those of another model with an ending.
TROUBLESOME = ["test", "all", "edit_cache", "math", "int", "3rd leg", "膝", "a", "a_test", "a_float", "a-law"]


@needs_gcc
@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
@pytest.mark.slow
def test_cmake_builds_models_of_any_name_side_by_side(tmp_path):
    text = '<mujoco><worldbody><body><joint name="J" axis="0 1 0"/><geom size=".1"/></body></worldbody></mujoco>'
    lines = ["cmake_minimum_required(VERSION 3.10)", "project(top C)", "enable_testing()"]
    for k, name in enumerate(TROUBLESOME):
        (tmp_path / f"{name}.xml").write_text(text)
        (tmp_path / str(k)).mkdir()
        write_model(model_code(load_mechanism(tmp_path / f"{name}.xml")), tmp_path / str(k), compiled=False)
        lines.append(f"add_subdirectory({k})")
    (tmp_path / "CMakeLists.txt").write_text("\n".join(lines))
    for words in (["-S", str(tmp_path), "-B", str(tmp_path / "built")], ["--build", str(tmp_path / "built")]):
        subprocess.run(["cmake", *words], check=True, capture_output=True)
    said = subprocess.run(["ctest"], cwd=tmp_path / "built", check=True, capture_output=True, text=True).stdout
    assert f"100% tests passed, 0 tests failed out of {2 * len(TROUBLESOME)}" in said


def test_the_command_writes_a_folder_with_its_costs(tmp_path, capsys):
    folder = tmp_path / "code"
    assert main(["export", "slider-crank", "--to", "c", "-o", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "linkplan_slider_crank_inverse_dynamics" in said
    names = {path.name for path in folder.iterdir()}
    assert {
        "linkplan_slider_crank.c",
        "linkplan_slider_crank.h",
        "linkplan_slider_crank_test.c",
        "CMakeLists.txt",
        "export.json",
    } <= names
    header = (folder / "linkplan_slider_crank.h").read_text()
    assert "s[0] O [rad], effort [N.m]" in header
    assert "q[2] B [m]" in header


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["no-such-model", "--to", "c"], "unknown model or problem 'no-such-model'"),
        (["optimus-knee", "--to", "c++"], "unknown format 'c++'"),
        (["knee-reach", "--to", "c", "--tracker", "mpc"], "legal: pd, pd+ff, lqr, gs-pd+ff"),
        (["knee-reach", "--to", "c", "--every-s", "0.1"], "--every-s"),
        (["knee-reach", "--to", "c", "--joints", "C"], "the plan's coordinates"),
        (["optimus-knee", "--to", "c", "--joints", "Q"], "'Q'"),
        (["optimus-knee", "--to", "c", "--tolerance", "0.1"], "--tolerance applies to the tables of a plan's law"),
        (["knee-reach", "--to", "c", "--sizes"], "--sizes applies to a model"),
        (["knee-reach", "--to", "csv", "--sizes"], "--sizes applies to C code only"),
        (["knee-reach", "--to", "csv", "--tolerance", "0.1"], "--tolerance applies to C code only"),
    ],
)
def test_bad_input_is_refused_in_one_line(words, said, tmp_path, capsys):
    assert main(["export", *words, "-o", str(tmp_path / "x")]) == 2
    assert said in capsys.readouterr().err.strip().splitlines()[-1]
    assert not (tmp_path / "x").exists()
