"""Hostile inputs of the fuzz: problem files, models, plan folders and command lines, drawn by a case's number and seed."""

import json
import os
import random
import re
import shutil
import tomllib
from pathlib import Path

KINDS = ("toml", "mjcf", "folder", "line")
PROBLEMS = ("knee-reach", "knee-sine", "slider-crank-turn", "cart-pole-swing-up", "knee-linear-reach")
MODELS = ("optimus-knee", "slider-crank", "cart-pole", "five-bar", "parallel-gripper")
# Values that have broken something, somewhere.
NUMBERS = (
    "0",
    "-0",
    "-1",
    "1e-300",
    "1e300",
    "-1e300",
    "inf",
    "-inf",
    "nan",
    "1e6",
    "1e9",
    "1e-9",
    "9" * 5000,
    "2147483648",
    "0.5",
    "3",
)
WORDS = ('""', '"none"', '"$x^$"', '"=1+1"', '"\\u001b[31m"', '"../.."', '"/dev/zero"', "true", "1979-05-27", "[]", "{}",
         "[1, 2]", "[[1], [2]]", "{ O = 1 }", '["O"]', "[nan]", "[inf, -inf]", "[" * 3000)  # fmt: skip


# What examples of keys name in braces, of the knee.
NAMES = {"hinge": "O", "free_hinge": "O", "joint": "O", "actuator": "act_O", "closure": "loop", "independent": '"O"',
         "joint_name": '"O"', "body": '"crank"', "effort_range": "[-50.0, 50.0]", "effort_high": "50.0"}  # fmt: skip
# Sections that are drawn more often than by chance: trackers and imperfections have most keys and run most code.
OFTEN = ("tracking", "imperfections", "robust", "limits")
FORMATS = ("keyframes", "mjcf", "ros", "mat", "csv", "parquet", "x")
# Commands and options that came after the first ones.
NEWER = ("experiment", "experiment", "export", "new", "render", "report", "schema", "batch", "completion")
OPTIONS = {
    "experiment": ["--samples", "--trackers", "--seed", "--design", "--levels", "--tube-deg", "--tube-m", "--workers",
                   "--threads", "--set", "--json", "--anyway", "-o"],
    "export": ["--to", "--every-s", "--set", "--json", "--anyway", "-o"],
    "render": ["--tracker", "--slow", "--fps", "--size-px", "--camera", "--at-s", "--instants", "--there-and-back", "--set",
               "-o"],
    "report": ["-o", "--json"], "new": ["-o", "--json"], "schema": ["-o", "--json"], "batch": ["-o", "--json", "--set"],
    "completion": ["--json"],
}  # fmt: skip
FLAGS = ("--json", "--anyway", "--version", "--there-and-back")
# What runs machines in MuJoCo, few of them.
FEW = ["--samples", "2", "--threads", "1"]


def damaged(rng: random.Random, content: bytes) -> bytes:
    """Return bytes with one to four random damages."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(data)))
        what = rng.randrange(6)
        if what == 0:
            data[at : at + 1] = bytes([rng.randrange(256)])
        elif what == 1:
            del data[at : at + rng.randint(1, 40)]
        elif what == 2:
            data[at:at] = rng.choice(
                [b"\xff\xfe", b"\0", b"\xe9", b"\x1b[2J", b"$x^$", b"\xed\xa0\x80", b"<", b'"', b"\n[", b"="]
            )
        elif what == 3:
            del data[at:]
        elif what == 4:
            data[at:at] = data[at : at + rng.randint(1, 200)]
        else:
            data[at:at] = rng.choice([b"9" * 5000, b"[" * 5000, b"a" * 100_000])
    return bytes(data)


def _example(rng: random.Random, section: str, key: str) -> str:
    """Return a value that a key may have, in words of the knee: its example, or one that is a table by joint."""
    from linkplan.planner.keys.key_table import key_table

    path = ("", "motors") if section == "motors" else (section, key)
    text = next((row.example for row in key_table() if (row.section, row.name) == path), "")
    if not text or rng.random() < 0.2:
        return rng.choice(["{ O = 1.0 }", "1.0", "{ act_O = 1.0 }", '"O"'])
    for name, value in NAMES.items():
        text = text.replace(f"{{{name}}}", value)
    return re.sub(r"\{\w+\}", "0.1", text)


def mutated_toml(rng: random.Random) -> bytes:
    """Return a problem file with values of keys replaced, keys added, or bytes damaged."""
    from linkplan.planner.files.tables import built_in_text, inline
    from linkplan.planner.keys.reading import KEYS

    text = built_in_text(rng.choice(PROBLEMS))
    if rng.random() < 0.25:
        return damaged(rng, text.encode())
    tables = tomllib.loads(text)
    lines: dict[str, dict[str, str]] = {"mesh": {"intervals": "10"}, "solver": {"max_time_s": "5.0"}}
    for section, content in tables.items():
        if isinstance(content, dict):
            lines.setdefault(section, {}).update({key: inline(value) for key, value in content.items()})
    for _ in range(rng.randint(1, 3)):
        section = rng.choice(OFTEN if rng.random() < 0.3 else list(KEYS))
        keys = KEYS[section] or ("act_O",)
        key = rng.choice(list(lines[section]) if rng.random() < 0.5 and lines.get(section) else keys)
        before = lines.setdefault(section, {}).get(key, _example(rng, section, key))
        number = rng.choice(NUMBERS)
        inner = re.sub(r"-?\d+(\.\d+)?", lambda _, number=number: number, before, count=1)
        lines[section][key] = rng.choice([number, rng.choice(WORDS), inner, inner, before])
    return "\n".join(f"[{s}]\n" + "\n".join(f"{k} = {v}" for k, v in keys.items()) for s, keys in lines.items()).encode()


def mutated_mjcf(rng: random.Random) -> bytes:
    """Return a model with attributes replaced or added, or bytes damaged."""
    from linkplan.models.catalogue import built_in_text

    text = built_in_text(rng.choice(MODELS))
    if rng.random() < 0.25:
        return damaged(rng, text.encode())
    for _ in range(rng.randint(1, 3)):
        found = list(re.finditer(r'(\w+)="([^"]*)"', text))
        one = rng.choice(found)
        number = rng.choice([*NUMBERS, "0 0 0", "1e300 1e300", "inf inf inf"])
        value = re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", lambda _, number=number: number, one[2], count=rng.randint(0, 1))
        value = rng.choice([value, value, number, "", "&#27;[31m", "$x^$", "=cmd", "\u00e9", "x" * 300])
        text = text[: one.start(2)] + value + text[one.end(2) :]
        if rng.random() < 0.4:
            extra = rng.choice([
                '<option timestep="{}"/>', '<compiler settotalmass="{}"/>', '<size memory="{}G"/>', '<size nuserdata="{}"/>',
                '<asset><hfield name="h" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset>', '<include file="/dev/zero"/>',
                '<include file="pipe.xml"/>', '<option gravity="0 0 {}"/>', '<option><flag gravity="disable"/></option>',
                '<worldbody><replicate count="{}"><site pos="1 0 0"/></replicate></worldbody>',
                '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>'
                '<worldbody><geom type="hfield" hfield="h"/></worldbody>',
                '<default><joint armature="{}"/></default>', '<default><geom solref="{} 1"/></default>',
                '<default><motor gear="{}"/></default>', '<default><joint damping="{}" frictionloss="{}"/></default>',
            ])  # fmt: skip
            extra = extra.replace("{0}", number).replace("{}", number)
            text = text.replace("</mujoco>", f"{extra}</mujoco>")
    content = text.encode("latin-1" if rng.random() < 0.05 else "utf-8", "replace")
    return damaged(rng, content) if rng.random() < 0.05 else content


def mutated_folder(rng: random.Random, plan: Path, folder: Path) -> None:
    """Write a plan's folder with its record, its arrays or its bytes changed."""
    import numpy as np

    shutil.copytree(plan, folder)
    what = rng.randrange(4)
    if what == 0:
        name = rng.choice(["plan.json", "trajectory.npz"])
        (folder / name).write_bytes(damaged(rng, (folder / name).read_bytes()))
    elif what == 1:
        said = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
        node = said if rng.random() < 0.5 else said["problem"][rng.choice(list(said["problem"]))]
        node = node if isinstance(node, dict) and node else said
        node[rng.choice(list(node))] = rng.choice(
            [None, -1, 1e300, 10**400, "x", "$x^$", [], {}, [1], {"a": 1}, True, "failed"]
        )
        (folder / "plan.json").write_text(json.dumps(said), encoding="utf-8")
    elif what == 2:
        with np.load(folder / "trajectory.npz") as stored:
            arrays = dict(stored)
        name = rng.choice(list(arrays))
        value = arrays[name]
        arrays[name] = rng.choice([
            value * rng.choice([0.0, 0.5, 1.001, -1.0, 1e10]) if value.dtype != bool else ~value, value.reshape(-1)[:1],
            value.astype(complex) if value.dtype != bool else value, np.array("x"), np.zeros((0, 3)),
            value.astype(np.float16),
        ])  # fmt: skip
        np.savez_compressed(folder / "trajectory.npz", **arrays)
    else:
        np.savez_compressed(folder / "trajectory.npz", breaks_s=np.zeros(8_500_000), position=np.zeros(3))


def command_line(rng: random.Random, plan: Path) -> list[str]:
    """Return a command line with options and values drawn at random."""
    command = rng.choice(["check", "track", "bode", "tune", "list", "plan", "compare", "view", "chek", "", *NEWER])
    line = [command] if command else []
    if command in ("track", "compare", "view", "experiment", "export", "render", "report"):
        line.append(str(plan) if rng.random() < 0.9 else rng.choice([str(plan / "plan.json"), "/", "/dev/zero", ""]))
    elif command == "schema":
        line.append(rng.choice(["problem", "batch", "x", ""]))
    elif command not in ("list", ""):
        line.append(rng.choice([*MODELS, *PROBLEMS, "nothing", "/dev/zero", ".", "", "\udce9", "x" * 5000]))
    options = ["--at-deg", "--set", "--kp", "--kd", "--period-s", "--delay-periods", "--frequency-hz",
               "--amplitude-deg", "--tracker", "--mass-factor", "--bandwidth-hz", "--phase-margin-deg",
               "--json", "--anyway", "--slow", "--seconds", "--version", "-o"]  # fmt: skip
    options = OPTIONS.get(command, options) if rng.random() < 0.8 else options
    if command == "experiment":
        line += FEW  # options drawn below overrule them
    if command == "render":
        line += ["--size-px", "64x64", "--fps", "1", "--instants", "1"]
    for option in rng.sample(options, rng.randint(0, min(3, len(options)))):
        line.append(option)
        if option not in FLAGS:
            values = [*NUMBERS, "O=1,5", "O=nan", "O=1,O=2", "=", "tracking.kp=1e300", "tracking.period_s=1e9",
                      "mesh.intervals=1e9", "tracking.duration_s=1e9", "motion.duration_s=1e6", "mechanism.independent=3",
                      "mechanism.home_deg.O=1e300", "imperfections.push_start_s=1e9", "imperfections.period_factor=1e-9",
                      "imperfections.encoder_resolution_deg=[0,1e300]", "robust.payload_factor=[0,1e9]", "limits.reserve=1",
                      "tracking.horizon_s=1e9", "tracking.integral_time_s=1e-300", "mpc", "lqi", "ct", "a:b", "os:system",
                      "a.mp4", "a.png", "a.gif", "a/b/c", "grid", "1/1", "nan/inf", "1x1", "99999x99999", "-1x", "act_O",
                      "pd", "lqr", "none", "a.b=[" + "[" * 3000, "/dev/full", "\udcff", ""]  # fmt: skip
            line.append(rng.choice(values))
    if command == "bode":
        line += ["--no-measure"]
    if command == "export":
        line += ["--to", rng.choice(FORMATS), "-o", "out.x"]
    if command == "render":
        line += ["-o", rng.choice(["out.png", "out.gif", "out.x"])]
    if command == "plan":
        line += ["--set", "mesh.intervals=10", "--set", "solver.max_time_s=5"]
    return line


def case_of(number: int, seed: int, plan: Path, folder: Path) -> tuple[str, list[str]]:
    """Return the kind and the command line of a case, its files written into an empty folder."""
    rng = random.Random(f"{seed}/{number}")
    kind = KINDS[number % len(KINDS)]
    os.mkfifo(folder / "pipe.xml")
    if kind == "toml":
        (folder / "a.toml").write_bytes(mutated_toml(rng))
        command = rng.choice(["check", "check", "check", "plan", "track", "experiment"])
        return kind, [command, str(folder / "a.toml"), *(FEW if command == "experiment" else [])]
    if kind == "mjcf":
        (folder / "a.xml").write_bytes(mutated_mjcf(rng))
        command = rng.choice(["check", "check", "check", "new"])
        line = [command, str(folder / "a.xml")]
        return kind, line + (["-o", str(folder / "out")] if rng.random() < 0.2 else [])
    if kind == "folder":
        mutated_folder(rng, plan, folder / "p")
        command = rng.choice(["track", "track", "track", "export", "report", "experiment", "render"])
        line = [command, str(folder / "p"), *(rng.choice([[], ["--anyway"]]) if command != "report" else [])]
        drawn = ["--size-px", "64x64", "--instants", "1", "-o", "out.png"]
        more = {"export": ["--to", rng.choice(FORMATS), "-o", "out.x"], "render": drawn, "experiment": FEW}
        return kind, line + more.get(command, [])
    return kind, command_line(rng, plan)
