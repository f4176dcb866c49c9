"""Hostile files: models, what they include, meshes, textures, problem and batch files."""

# One case a line, of whatever length: a table.
# ruff: noqa: E501
# fmt: off

import os
import socket
import struct
import zlib
from pathlib import Path

from linkplan.models.catalogue import built_in_text
from linkplan.planner.files.tables import built_in_text as problem_text
from tests.bench.hostile import Case

KNEE, REACH = built_in_text("optimus-knee"), problem_text("knee-reach")
# Quick to plan.
QUICK = ("--set", "mesh.intervals=10", "--set", "solver.max_time_s=5")


def knee(*changes: tuple[str, str], extra: str = "") -> str:
    """Return the knee's model with texts replaced, each of which must be in it, and something added at its end."""
    text = KNEE
    for old, new in changes:
        if old not in text:
            raise ValueError(f"{old!r} is not in the model")
        text = text.replace(old, new)
    return text.replace("</mujoco>", f"{extra}</mujoco>")


def meshed(name: str, more: str = "") -> str:
    """Return the knee's model with a mesh from a file."""
    mesh = f'<asset><mesh name="m" file="{name}" {more}/></asset>'
    return knee(('<geom name="O" class="crank" type="sphere" size="0.015"/>', '<geom name="O" class="crank" type="mesh" mesh="m" mass="0.1"/>'), extra=mesh)


def textured(name: str) -> str:
    """Return the knee's model with a texture from a file."""
    return knee(extra=f'<asset><texture name="t" type="2d" file="{name}"/><material name="t" texture="t"/></asset>')


def stl(count: int, real: int) -> bytes:
    """Return a binary STL that says how many triangles it has, and has another number."""
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1e-3, 0)
    return b"\0" * 80 + struct.pack("<I", count) + triangle * real


def png(width: int, height: int, rows: int | None = None) -> bytes:
    """Return a grey PNG, of as many rows as are said, by default all."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    squeeze = zlib.compressobj(9)
    row = b"\0" * (width + 1)
    data = b"".join(squeeze.compress(row) for _ in range(height if rows is None else rows)) + squeeze.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def a_socket(folder: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        here = os.open(".", os.O_RDONLY)
        os.chdir(folder)
        one.bind("s.toml")
        os.fchdir(here)
        os.close(here)


def loops_of_links(folder: Path) -> None:
    os.symlink("b.toml", folder / "a.toml")
    os.symlink("a.toml", folder / "b.toml")
    os.symlink("b.xml", folder / "a.xml")
    os.symlink("a.xml", folder / "b.xml")


def long_chain(folder: Path) -> None:
    (folder / "0.toml").write_text(REACH)
    for k in range(60):
        os.symlink(f"{k}.toml", folder / f"{k + 1}.toml")


def model(name: str, text: str | bytes, *words: str, **more) -> Case:
    return Case(name=f"model {name}", words=words or ("check", "m.xml"), files={"m.xml": text} | more.pop("files", {}), **more)


def problem(name: str, text: str | bytes, *words: str, **more) -> Case:
    return Case(name=f"problem {name}", words=words or ("plan", "p.toml", *QUICK), files={"p.toml": text} | more.pop("files", {}), **more)


ENTITIES = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(12)
) + "]>"
OBJ = "".join(f"v {k % 101}e-3 {k % 97}e-3 {k % 89}e-3\n" for k in range(300)) + "".join(f"f {k} {k + 1} {k + 2}\n" for k in range(1, 297))

FILES = (
    model("of entities that grow", ENTITIES + KNEE.replace("optimus-knee", "&m;"), codes=(0, 2)),
    model("of an outer entity", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>' + KNEE.replace('name="thigh" pos', 'name="&e;" pos'), codes=(0, 2)),
    model("with an unknown plugin", knee(extra='<extension><plugin plugin="no.such"/></extension>')),
    model("with an elasticity plugin", knee(extra='<extension><plugin plugin="mujoco.elasticity.cable"/></extension>'), codes=(0, 2)),
    model("with a plugin actuator", knee(('<motor name="act_O"', '<plugin plugin="mujoco.pid" name="p" joint="O"/><motor name="act_O"'), extra='<extension><plugin plugin="mujoco.pid"/></extension>'), codes=(0, 1, 2)),
    model("that includes itself", knee(extra='<include file="m.xml"/>'), says="circle|include"),
    model("in a circle of two", knee(extra='<include file="n.xml"/>'), files={"n.xml": '<mujoco><include file="m.xml"/></mujoco>'}, says="circle"),
    model("that includes a missing file", knee(extra='<include file="gone.xml"/>')),
    model("that includes a folder", knee(extra='<include file="planned"/>'), make=lambda _: None),
    model("that includes its parent", knee(extra='<include file="../../../../../../etc/passwd"/>')),
    model("that includes a device", knee(extra='<include file="/dev/zero"/>')),
    model("that attaches itself", knee(extra='<asset><model name="x" file="m.xml"/></asset>')),
    model("with a mesh that is missing", meshed("gone.stl")),
    model("with an STL of too many triangles", meshed("a.stl"), files={"a.stl": stl(2**31, 1)}),
    model("with an STL of 2^32-1 triangles", meshed("a.stl"), files={"a.stl": stl(2**32 - 1, 1)}),
    model("with an STL of fewer triangles", meshed("a.stl"), files={"a.stl": stl(1, 20)}),
    model("with an STL of no triangle", meshed("a.stl"), files={"a.stl": stl(0, 0)}),
    model("with an STL cut in its head", meshed("a.stl"), files={"a.stl": b"\0" * 40}),
    model("with an empty STL", meshed("a.stl"), files={"a.stl": b""}),
    model("with an STL of text", meshed("a.stl"), files={"a.stl": "solid x\n" + "facet\n" * 5}),
    model("with an STL of NaN", meshed("a.stl"), files={"a.stl": b"\0" * 80 + struct.pack("<I", 4) + struct.pack("<12fH", *[float("nan")] * 12, 0) * 4}),
    model("with an STL of 1e38", meshed("a.stl"), files={"a.stl": b"\0" * 80 + struct.pack("<I", 4) + struct.pack("<12fH", *[1e38 * (-1) ** k for k in range(12)], 0) * 4}),
    model("with an OBJ of text", meshed("a.obj"), files={"a.obj": "hello\n" * 10}),
    model("with an OBJ of wild faces", meshed("a.obj"), files={"a.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\nf -5 -6 -7\nf 0 0 0\n"}),
    model("with an OBJ of faces beyond integers", meshed("a.obj"), files={"a.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"}),
    model("with an OBJ of NaN", meshed("a.obj"), files={"a.obj": OBJ.replace("v 5e-3", "v nan")}, codes=(0, 1, 2)),
    model("with an OBJ of 200 MB", meshed("a.obj"), make=lambda f: (f / "a.obj").write_text(OBJ + "# " + "x" * 1000 + "\n" * 2 + ("#" + "y" * 999 + "\n") * 200_000), codes=(0, 1, 2)),
    model("with an OBJ of 600 MB", meshed("a.obj"), make=lambda f: os.truncate(os.open(f / "a.obj", os.O_RDWR | os.O_CREAT), 600_000_000)),
    model("with an OBJ of 100 MB of vertices", meshed("a.obj"), make=lambda f: (f / "a.obj").write_text("".join(f"v {k % 101}e-3 {k % 97}e-3 {k % 89}e-3\n" for k in range(4_000_000)) + "f 1 2 3\nf 2 3 4\n"), codes=(0, 1, 2)),
    model("with an MSH of wrong counts", meshed("a.msh"), files={"a.msh": struct.pack("<4i", 2**30, 2**30, 2**30, 2**30)}),
    model("with an MSH of negative counts", meshed("a.msh"), files={"a.msh": struct.pack("<4i", -5, -5, -5, -5) + b"\0" * 100}),
    model("with a mesh of another kind", meshed("a.exe"), files={"a.exe": b"MZ"}),
    model("with a mesh by an absolute path", meshed("/dev/zero")),
    model("with a mesh that is a pipe", meshed("a.stl"), make=lambda f: os.mkfifo(f / "a.stl")),
    model("with a mesh scaled to infinity", meshed("a.obj", 'scale="1e300 1e300 1e300"'), files={"a.obj": OBJ}),
    model("with a mesh without volume", meshed("a.obj"), files={"a.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 3 4\n"}, codes=(0, 1, 2)),
    model("with a texture of 12000 x 12000", textured("a.png"), files={"a.png": png(12000, 12000)}, codes=(0, 2)),
    model("with a texture of 60000 x 60000", textured("a.png"), files={"a.png": png(60000, 60000, 10)}),
    model("with a texture cut short", textured("a.png"), files={"a.png": png(100, 100)[:60]}),
    model("with a texture that lies of its size", textured("a.png"), files={"a.png": png(4000, 4000, 3)}),
    model("with a texture that is text", textured("a.png"), files={"a.png": "hello"}),
    model("with a big texture named otherwise", textured("a.bin"), files={"a.bin": png(60000, 60000, 10)}),
    model("with a texture in capitals", textured("a.PNG"), files={"a.PNG": png(60000, 60000, 10)}),
    model("with a texture of a content type", knee(extra='<asset><texture name="t" type="2d" file="a.x" content_type="image/png"/></asset>'), files={"a.x": png(60000, 60000, 10)}),
    model("with a KTX texture", textured("a.ktx"), files={"a.ktx": b"\xabKTX 11\xbb\r\n\x1a\n" + b"\xff" * 64}, codes=(0, 2)),
    model("with a height field of a PNG", knee(extra='<asset><hfield name="h" file="a.png" size="1 1 1 1"/></asset>'), files={"a.png": png(50000, 50000, 5)}),
    model("with a binary height field that lies", knee(extra='<asset><hfield name="h" file="a.bin" size="1 1 1 1"/></asset>'), files={"a.bin": struct.pack("<2i", 2**30, 2**30)}),
    model("with a binary height field of negative size", knee(extra='<asset><hfield name="h" file="a.bin" size="1 1 1 1"/></asset>'), files={"a.bin": struct.pack("<2i", -1, -1) + b"\0" * 64}),
    model("with a skin that lies", knee(extra='<asset><skin name="s" file="a.skn"/></asset>'), files={"a.skn": struct.pack("<4i", 2**30, 2**30, 2**30, 2**30)}),
    model("with a skin of negative counts", knee(extra='<asset><skin name="s" file="a.skn"/></asset>'), files={"a.skn": struct.pack("<4i", -1, -1, -1, -1)}),
    model("of 3000 levels", "<mujoco><worldbody>" + "<body>" * 3000 + "</body>" * 3000 + "</worldbody></mujoco>"),
    model("of 400 bodies in a chain", "<mujoco><worldbody>" + '<body pos="0 0 .1"><joint/><geom size=".01"/>' * 400 + "</body>" * 400 + "</worldbody></mujoco>", codes=(0, 1, 2)),
    model("in UTF-16", KNEE.encode("utf-16")),
    model("in Latin-1 that says so", b'<?xml version="1.0" encoding="latin-1"?>' + KNEE.replace('name="O"', 'name="\u00e9"').encode("latin-1")),
    model("with a mark of byte order", "\ufeff" + KNEE, codes=(0,)),
    model("in DOS lines", KNEE.replace("\n", "\r\n"), codes=(0,)),
    model("with names in Arabic", KNEE.replace('"O"', '"\u0645\u0641\u0635\u0644"'), codes=(0, 2)),
    model("with names in emoji", KNEE.replace('"O"', '"\U0001f9bf"'), codes=(0,)),
    model("with names that turn the writing", KNEE.replace('"O"', '"\u202eO"')),
    model("with names of white space", KNEE.replace('"O"', '"   "'), codes=(0, 2)),
    model("with names of options", KNEE.replace('"O"', '"--json"'), codes=(0,)),
    model("with names of paths", KNEE.replace('"O"', '"../../x"').replace('"B"', '"/etc/passwd"'), "check", "m.xml", "-o", "out", codes=(0,)),
    model("with names of HTML", KNEE.replace('"O"', '"&lt;script&gt;alert(1)&lt;/script&gt;"'), "check", "m.xml", "-o", "out", "--report", codes=(0,),
          after=lambda f: "a script of a name" if "<script>alert(1)" in (f / "out/report.html").read_text() else ""),
    model("with names of mathtext", KNEE.replace('"O"', '"$\\\\frac{$"').replace('"B"', '"$x^$_{"'), "check", "m.xml", "-o", "out", codes=(0,)),
    model("with a name as long as may be", KNEE.replace('"O"', f'"{"x" * 500}"'), "check", "m.xml", "-o", "out", codes=(0,)),
    model("that is a shell script", "#!/bin/sh\nrm -rf /\n"),
    model("that is one tag", "<"),
    model("that is a comment for ever", "<!-- " + "x" * 1_000_000),
    model("that is JSON", '{"mujoco": 1}'),
    model("that is TOML", REACH),
    model("that is URDF", '<robot name="r"><link name="a"/><joint name="j" type="prismatic"><parent link="a"/><child link="a"/></joint></robot>'),
    model("of zero mass", knee(('density="1000"', 'density="0"')), codes=(0, 1, 2)),
    model("of tiny mass", knee(('density="1000"', 'density="1e-250"')), codes=(0, 1, 2)),
    model("of huge mass", knee(('density="1000"', 'density="1e15"')), codes=(0, 1, 2)),
    model("of huge gear", knee(('ctrlrange="-100 100"', 'ctrlrange="-100 100" gear="1e11"')), codes=(0, 1, 2)),
    model("of zero gear", knee(('ctrlrange="-100 100"', 'ctrlrange="-100 100" gear="0"')), codes=(0, 1, 2)),
    model("whose control is one number", knee(('ctrlrange="-100 100"', 'ctrlrange="5 5"')), codes=(0, 1, 2)),
    model("of a muscle", knee(('<motor name="act_O" joint="O" ctrlrange="-100 100"/>', '<muscle name="act_O" joint="O" ctrlrange="0 1"/>')), codes=(0, 1, 2)),
    model("of an adhesion", knee(('<motor name="act_O" joint="O" ctrlrange="-100 100"/>', '<adhesion name="a" body="crank" ctrlrange="0 1"/>')), codes=(0, 1, 2)),
    model("of flex", knee(("</worldbody>", '<body><flexcomp name="f" type="grid" count="4 4 1" spacing=".1 .1 .1" mass="1" dim="2"/></body></worldbody>')), codes=(0, 1, 2)),
    model("of a million sites", "<mujoco><worldbody>" + '<site/>' * 300_000 + "</worldbody></mujoco>", codes=(0, 1, 2)),
    model("of 10,000 keyframes", knee(extra="<keyframe>" + '<key qpos="0 0 0"/>' * 10_000 + "</keyframe>"), codes=(0, 1, 2)),
    model("of arms without joints", "<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>"),
    model("that is empty", "<mujoco/>"),
    model("that is a file of spaces", " \n" * 100),
    model("planned from a bomb of textures", textured("a.png"), "plan", "p.toml", files={"a.png": png(60000, 60000, 9), "p.toml": REACH.replace('"optimus-knee"', '"m.xml"')}),
    problem("in a circle of links", REACH, "plan", "a.toml", make=loops_of_links),
    problem("model in a circle of links", REACH, "check", "a.xml", make=loops_of_links),
    problem("behind sixty links", REACH, "plan", "60.toml", *QUICK, make=long_chain),
    problem("that is a folder", REACH, "plan", "d.toml", make=lambda f: (f / "d.toml").mkdir()),
    problem("that is a socket", REACH, "plan", "s.toml", make=a_socket),
    problem("that is a pipe", REACH, "plan", "f.toml", make=lambda f: os.mkfifo(f / "f.toml")),
    problem("that is a device", REACH, "plan", "/dev/random"),
    problem("that is the terminal", REACH, "plan", "/dev/tty"),
    problem("from stdin", REACH, "plan", "/dev/stdin"),
    problem("from its own memory", REACH, "plan", "/proc/self/mem"),
    problem("from a file of the kernel", REACH, "plan", "/proc/kmsg"),
    problem("of 20 MB", REACH + "# x\n" * 5_000_000),
    problem("of one line of 10 MB", REACH + "description2 = '" + "x" * 10_000_000 + "'\n"),
    problem("with keys in conflict", REACH + "\n[motion.start_deg.O]\nx = 1\n"),
    problem("with dotted keys in conflict", "motion.kind = 'reach'\n" + REACH),
    problem("with a table twice", REACH + "\n[motion]\nkind = 'reach'\n"),
    problem("with a key twice", REACH.replace('kind = "reach"', 'kind = "reach"\nkind = "reach"')),
    problem("with an inline table extended", REACH + "\n[motion.goal_deg]\nA = 1\n"),
    problem("of arrays of tables", REACH.replace("[objective]", "[[objective]]")),
    problem("of 100,000 dotted levels", "a" + ".a" * 100_000 + " = 1\n" + REACH),
    problem("of 100,000 tables", REACH + "".join(f"[a{k}]\n" for k in range(100_000))),
    problem("of 200,000 waypoints", REACH + "[[motion.waypoints]]\nat_deg = { O = 1.0 }\n" * 50_000),
    problem("with a date", REACH.replace("0.16", "1979-05-27T07:32:00Z")),
    problem("with a boolean", REACH.replace("0.16", "true")),
    problem("with infinity", REACH.replace("0.16", "inf")),
    problem("with not a number", REACH.replace("56.27", "nan")),
    problem("with a number of a million digits", REACH.replace("56.27", "9" * 1_000_000)),
    problem("with a hexadecimal number", REACH.replace("56.27", "0x38"), codes=(0, 1)),
    problem("with a key of nothing", REACH.replace("O = 56.27", '"" = 56.27')),
    problem("with a key of zero", REACH.replace("O = 56.27", '"\\u0000" = 56.27')),
    problem("with a key of a newline", REACH.replace("O = 56.27", '"O\\nlinkplan: ok" = 56.27')),
    problem("with a key of emoji", REACH.replace("O = 56.27", '"\U0001f9bf" = 56.27')),
    problem("with a surrogate", REACH.encode().replace(b'"optimus-knee"', b'"\xed\xa0\x80"')),
    problem("with a model of a zero byte", REACH.replace('"optimus-knee"', '"a\\u0000b"')),
    problem("with a model that is the file itself", REACH.replace('"optimus-knee"', '"p.toml"')),
    problem("with a model that is a folder", REACH.replace('"optimus-knee"', '"."')),
    problem("with a model that is a device", REACH.replace('"optimus-knee"', '"/dev/zero"')),
    problem("with a model that is text", REACH.replace('"optimus-knee"', "'''" + KNEE + "'''"), codes=(0, 1)),
    problem("with a model of 5000 characters", REACH.replace('"optimus-knee"', f'"{"x" * 5000}"')),
    problem("with a guess in itself", REACH + '\n[guess]\nplan = "."\n'),
    problem("with a guess that is a pipe", REACH + '\n[guess]\nplan = "g"\n', make=lambda f: ((f / "g").mkdir(), os.mkfifo(f / "g/trajectory.npz"))),
    problem("with a description of HTML", REACH.replace("the shank", "</script><script>alert(1)</script>"), "plan", "p.toml", *QUICK, "-o", "out", "--report", codes=(0,),
            after=lambda f: "a script of a description" if "<script>alert(1)" in (f / "out/report.html").read_text() else ""),
    problem("whose file's name is HTML", "", "plan", "<img src=x onerror=alert(1)>.toml", *QUICK, "-o", "out", "--report", files={"<img src=x onerror=alert(1)>.toml": REACH}, codes=(0,),
            after=lambda f: "an image of a name" if "<img src=x" in (f / "out/report.html").read_text() else ""),
    problem("whose file's name is a formula", "", "plan", "=cmd|' /C calc'!A0.toml", *QUICK, "-o", "out", files={"=cmd|' /C calc'!A0.toml": REACH}, codes=(0,)),
    problem("whose file's name has a newline", "", "plan", "a\nb.toml", *QUICK, "-o", "out", files={"a\nb.toml": REACH}, codes=(0,)),
    problem("whose file's name begins with dashes", "", "plan", "--", "--x.toml", *QUICK, files={"--x.toml": REACH}, codes=(0, 2)),
    problem("whose file's name is dashes", "", "plan", "./--.toml", *QUICK, files={"--.toml": REACH}, codes=(0,)),
    problem("whose file's name is emoji", "", "plan", "\U0001f9bf.toml", *QUICK, "-o", "\U0001f9bf", files={"\U0001f9bf.toml": REACH}, codes=(0,)),
    problem("whose file's name turns the writing", "", "plan", "\u202elmot.toml", *QUICK, "-o", "out", files={"\u202elmot.toml": REACH}, codes=(0,)),
    problem("whose file's name is of 250 bytes", "", "plan", "x" * 245 + ".toml", *QUICK, "-o", "y" * 250, files={"x" * 245 + ".toml": REACH}, codes=(0,)),
    problem("of a batch without end", 'problem = "knee-reach"\n[sweep]\n"motion.duration_s" = { from = 0.1, to = 0.2, count = 1000000000 }\n', "batch", "p.toml"),
    problem("of a batch of itself", 'problem = "p.toml"\n[[case]]\nname = "a"\n', "batch", "p.toml"),
    problem("of a batch whose cases climb", 'problem = "knee-reach"\n[[case]]\nname = "../../x"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out"),
    problem("of a batch whose case is named .", 'problem = "knee-reach"\n[[case]]\nname = "."\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out"),
    problem("of a batch whose case is the record", 'problem = "knee-reach"\n[[case]]\nname = "batch.json"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out", codes=(0, 2)),
    problem("of a batch whose case is the manifest", 'problem = "knee-reach"\n[[case]]\nname = ".linkplan.json"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out", codes=(0, 2)),
    problem("of a batch whose cases have one name", 'problem = "knee-reach"\n' + '[[case]]\nname = "a"\nset = ["motion.goal_deg.O=20"]\n' * 2, "batch", "p.toml", "-o", "out"),
    problem("of a batch whose cases' names differ by case", 'problem = "knee-reach"\n' + "".join(f'[[case]]\nname = "{n}"\nset = ["motion.goal_deg.O=20"]\n' for n in "aA"), "batch", "p.toml", "-o", "out", codes=(0, 2)),
    problem("of a batch whose case has a long name", 'problem = "knee-reach"\n' + f'[[case]]\nname = "{"x" * 400}"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out"),
    problem("of a batch whose case's name is a zero", 'problem = "knee-reach"\n[[case]]\nname = "a\\u0000"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out"),
    problem("of a batch whose case's name is a newline", 'problem = "knee-reach"\n[[case]]\nname = "a\\nb"\nset = ["motion.goal_deg.O=20"]\n', "batch", "p.toml", "-o", "out", codes=(0, 2)),
)
