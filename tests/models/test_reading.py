"""Files of models: read up to a bound, left out and named where they are missing or too large, compiled once."""

import base64
import os
import struct
import tracemalloc

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models import library
from linkplan.models.errors import ModelError, ProblemError
from linkplan.models.library import compile_model
from linkplan.models.mechanism import load_mechanism
from linkplan.models.reading import parse_toml, read_file, read_head
from linkplan.models.selection import Selection
from tests.support.four_bar_urdf import FOUR_BAR, LOOP_JOINT, TRANSMISSION, robot
from tests.support.refusals import assert_refused, refusal


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
    assert_refused(lambda: read_file(tmp_path / "file", "it", 2), "3 bytes; at most 2", kind=ProblemError)


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


ARM = """<mujoco model="arm"><compiler meshdir="assets"/>
  <asset><mesh name="shell" file="shell.stl"/><texture name="wood" type="2d" file="wood.png"/>
    <material name="wooden" texture="wood"/></asset>
  <worldbody><body name="arm"><joint name="A" axis="0 1 0"/>{inertial}
    <geom type="mesh" mesh="shell"/>
    <geom type="capsule" size=".01" fromto="0 0 0 .2 0 0" material="wooden"/></body></worldbody>
  <actuator><motor joint="A" ctrlrange="-1 1"/></actuator></mujoco>"""
ONE_PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4//8/AAX+Av4N70a4AAAAAElFTkSuQmCC")
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n"
INERTIAL = '<inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>'


def test_missing_meshes_and_textures_are_left_out_and_named(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=INERTIAL))
    _, model, (note,) = compile_model(file)
    assert (model.ngeom, model.nmesh, model.ntex) == (1, 0, 0)
    assert model.body("arm").mass[0] == 1.0
    assert "shell.stl" in note
    assert "wood.png" in note
    assert note in load_mechanism(file).notes


def test_a_model_named_mjcf_finds_its_files(tmp_path):
    """MuJoCo itself reads .xml and .urdf; the robots of K-Scale are .mjcf."""
    file = tmp_path / "arm.mjcf"
    file.write_text(ARM.format(inertial=INERTIAL))
    (tmp_path / "wood.png").write_bytes(ONE_PIXEL)
    name, model, (note,) = compile_model(file)
    assert (name, model.ngeom, model.ntex) == ("arm", 1, 1)
    assert note.startswith("missing files are ignored, with everything that uses them: shell.stl")
    file.write_text('<mujoco><include file="other.mjcf"/></mujoco>')
    with pytest.raises(ModelError, match=r"does not parse: .*other\.mjcf.*; model files are named \.xml or \.urdf$"):
        compile_model(file)


def test_a_file_of_the_same_name_in_another_folder_is_not_the_mesh_that_is_missing(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=INERTIAL).replace("shell.stl", "2023/shell.stl"))
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "shell.stl").write_bytes(b"of another robot")
    _, model, (note,) = compile_model(file)
    assert model.nmesh == 0
    assert "shell.stl" in note


@pytest.mark.parametrize(("content", "remedy"), [(None, "<inertial>"), (POINTER, "git lfs pull")])
def test_a_mesh_whose_mass_a_body_needs_is_not_left_out(tmp_path, content, remedy):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=""))
    (tmp_path / "assets").mkdir()
    if content:
        (tmp_path / "assets" / "shell.stl").write_text(content)
    with pytest.raises(ModelError, match=rf"body 'arm' has its mass from mesh 'shell\.stl'.*{remedy}"):
        compile_model(file)


def test_git_lfs_pointers_count_as_files_that_are_not_there(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=INERTIAL))
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "shell.stl").write_text(POINTER)
    (tmp_path / "wood.png").write_text(POINTER)
    _, model, (note,) = compile_model(file)
    assert (model.ngeom, model.nmesh, model.ntex) == (1, 0, 0)
    assert all(words in note for words in ("shell.stl", "wood.png", "git lfs pull"))


def test_contact_pairs_with_a_floor_of_another_file_are_left_out_and_named(tmp_path):
    file = tmp_path / "arm.xml"
    body = '<body name="leg"><joint axis="0 1 0"/><geom name="foot" size=".1"/></body>'
    excluded = '<exclude body1="terrain" body2="leg"/><exclude body1="world" body2="leg"/>'
    pair = f'<contact><pair geom1="floor" geom2="foot"/>{excluded}</contact>'
    file.write_text(f"<mujoco><worldbody>{body}</worldbody>{pair}</mujoco>")
    _, model, notes = compile_model(file)
    assert (model.npair, model.nexclude) == (0, 1)
    assert notes[0].endswith("geoms or bodies of other files are ignored: floor, terrain")


def test_attributes_of_an_older_mujoco_are_left_out_and_named(tmp_path):
    """MuJoCo refuses them; MJCF files of many humanoids have `sensornoise`, those of hands `collision` or `apirate`."""
    file = tmp_path / "arm.xml"
    old = '<option apirate="100" collision="predefined"><flag sensornoise="enable" gravity="disable"/></option><asset>'
    file.write_text(ARM.format(inertial=INERTIAL).replace("<asset>", old))
    (tmp_path / "wood.png").write_bytes(ONE_PIXEL)
    name, model, notes = compile_model(file)
    assert (name, model.ntex, model.opt.disableflags) == ("arm", 1, mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    assert notes[0] == "attributes of an older MuJoCo are left out: apirate, collision, sensornoise"
    whole = tmp_path / "whole.xml"
    whole.write_text('<mujoco><include file="arm.xml"/><worldbody><geom size=".1"/></worldbody></mujoco>')
    assert compile_model(whole)[2][0] == notes[0], "of files that are included, too"
    file.write_text(file.read_text().replace("apirate", "newrate"))
    assert_refused(lambda: compile_model(file), "unrecognized attribute: 'newrate'", kind=ModelError)


# `{}` is for the attributes of a texture.
MODEL = """<mujoco><asset><texture name="large" {}/><material name="skin" texture="large"/></asset><worldbody>
<body><joint name="J" axis="0 1 0"/><geom size=".05" pos="0 0 -.3" mass="1" material="skin"/></body></worldbody>
<actuator><motor joint="J" ctrlrange="-1 1"/></actuator></mujoco>"""
FIELD = """<mujoco><asset><hfield name="hill" size="1 1 1 1" {}/></asset><worldbody><geom type="hfield" hfield="hill"/>
<body pos="0 0 5"><joint name="J" axis="0 1 0"/><geom size=".05" mass="1"/></body></worldbody></mujoco>"""
IMAGE = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 30_000, 30_000)


def written(folder, text: str, name: str = "model.xml") -> str:
    folder.mkdir(exist_ok=True)
    (folder / "image.png").write_bytes(IMAGE)
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


@pytest.mark.parametrize(
    ("attributes", "size"),
    [
        ('type="2d" file="image.png"', "900"),
        ('type="cube" fileright="image.png"', "900"),
        ('type="2d" builtin="checker" width="30000" height="30000"', "900"),
        ('type="cube" builtin="flat" width="5000" height="5000"', "150"),
    ],
)
def test_a_texture_too_large_for_memory_is_left_out_and_named(tmp_path, attributes, size):
    mechanism = linkplan.load_mechanism(written(tmp_path, MODEL.format(attributes)))
    assert any(f"large ({size} million pixels)" in note for note in mechanism.notes), mechanism.notes
    assert mechanism.model.ntex == 0
    assert mechanism.model.nmat == 1


def test_a_texture_of_an_attached_model_is_found_beside_it(tmp_path):
    written(tmp_path / "part", MODEL.format('type="2d" file="image.png"'), "child.xml")
    attached = (
        '<asset><model name="c" file="part/child.xml"/></asset><worldbody><frame><attach model="c" prefix="p_"/></frame>'
    )
    place = tmp_path / "model.xml"
    place.write_text(f"<mujoco>{attached}</worldbody></mujoco>", encoding="utf-8")
    mechanism = linkplan.load_mechanism(place)
    assert any("p_large (900 million pixels)" in note for note in mechanism.notes)


def test_textures_are_bounded_together_and_small_ones_stay(tmp_path):
    """Two images of 30 million pixels fit into the limit, and a third one does not."""
    textures = "".join(f'<texture name="t{k}" type="2d" builtin="flat" width="6000" height="5000"/>' for k in range(3))
    text = MODEL.format('type="2d" builtin="flat" width="8" height="8"').replace("<asset>", f"<asset>{textures}")
    mechanism = linkplan.load_mechanism(written(tmp_path, text))
    assert [note for note in mechanism.notes if "million pixels" in note] == [
        "textures of more than 67.1 million pixels together are left out of pictures: t2 (30 million pixels)"
    ]
    assert mechanism.model.ntex == 3


@pytest.mark.parametrize("attributes", ['file="image.png"', 'nrow="10000" ncol="10000"'])
def test_a_height_field_too_large_for_memory_is_refused(tmp_path, attributes):
    with pytest.raises(ModelError, match=r"height field 'hill' has \d+ million points; .* at most 67\.1 million"):
        linkplan.load_mechanism(written(tmp_path, FIELD.format(attributes)))


HINGE = '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body></worldbody></mujoco>'


def test_what_the_compiler_cannot_name_is_a_refusal(monkeypatch):
    def failing(_):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr(mujoco.MjSpec, "compile", failing)
    assert_refused(lambda: compile_model(HINGE), "does not compile", kind=ModelError)


WHOLE = robot(FOUR_BAR, LOOP_JOINT, TRANSMISSION)
# What tinyxml2, MuJoCo's reader, takes and the XML standard forbids.
LENIENT = {
    "two dashes in a comment": robot("<!-- a -- b -->", FOUR_BAR, LOOP_JOINT, TRANSMISSION),
    "an unbound prefix": robot('<drake:foo name="x"/>', FOUR_BAR, LOOP_JOINT, TRANSMISSION),
    "an unbound prefix of an attribute": WHOLE.replace("<robot", '<robot drake:x="1"'),
    "an entity of HTML": robot("<description>a&nbsp;b</description>", FOUR_BAR, LOOP_JOINT, TRANSMISSION),
    "an ampersand": robot("<description>a & b</description>", FOUR_BAR, LOOP_JOINT, TRANSMISSION),
    "an ampersand in an attribute": WHOLE.replace("four-bar", "a & b"),
    "a comment's mark in CDATA": robot("<d><![CDATA[ <!-- ]]></d>", FOUR_BAR, LOOP_JOINT, TRANSMISSION, "<!-- x -->"),
    "a line before the declaration": '\n<?xml version="1.0"?>\n' + WHOLE,
    "an unknown encoding": '<?xml version="1.0" encoding="gb2312"?>' + WHOLE,
    "text before the root": "hello " + WHOLE,
    "a capital letter": WHOLE.replace("<robot", "<Robot").replace("</robot", "</Robot"),
    "a default namespace": WHOLE.replace("<robot", '<robot xmlns="http://drake.mit.edu"'),
    "a byte order mark": "\ufeff" + WHOLE,
}
REFUSED = {
    "a control character": robot("<description>\x01</description>", FOUR_BAR, LOOP_JOINT),
    "a character of number 1": WHOLE.replace("four-bar", "&#1;"),
    "two roots": WHOLE + WHOLE,
    "a root of another kind": WHOLE + "<x/>",
    "a tag's mark in an attribute": WHOLE.replace("four-bar", "a<b"),
    "no space between attributes": WHOLE.replace('name="B" type', 'name="B"type'),
    "an entity": '<!DOCTYPE robot [<!ENTITY loop "x">]>' + robot(FOUR_BAR, "&loop;"),
    "two attributes of one name": WHOLE.replace('name="B"', 'name="B" name="C"'),
}


@pytest.mark.parametrize("name", LENIENT)
@pytest.mark.parametrize("ending", [".urdf", ".mjcf"])
def test_a_file_that_mujocos_reader_takes_keeps_its_loops_and_motors(tmp_path, name, ending):
    place = tmp_path / f"robot{ending}"
    place.write_text(LENIENT[name], encoding="utf-8")
    mechanism = linkplan.load_mechanism(place)
    assert (mechanism.dof, mechanism.n_u) == (1, 1)


def test_bytes_that_are_not_utf_8_beside_the_names_lose_nothing(tmp_path):
    place = tmp_path / "robot.urdf"
    place.write_bytes(robot("<author>\xe9</author>", FOUR_BAR, LOOP_JOINT, TRANSMISSION).encode("latin-1"))
    assert linkplan.load_mechanism(place).dof == 1


@pytest.mark.parametrize("name", REFUSED)
def test_a_urdf_that_is_read_in_parts_only_is_refused_in_one_line(tmp_path, name):
    place = tmp_path / "robot.urdf"
    place.write_text(REFUSED[name], encoding="utf-8")
    assert_refused(lambda: linkplan.load_mechanism(place), "robot.urdf", kind=ModelError)


def test_the_place_that_is_not_well_formed_is_named(tmp_path):
    place = tmp_path / "robot.urdf"
    place.write_text("<!-- two\nlines -- -->\n" + REFUSED["a control character"], encoding="utf-8")
    assert_refused(lambda: linkplan.load_mechanism(place), "line 3, column", kind=ModelError)


MJCF = '<mujoco><worldbody>{}<body><joint name="j"/><geom size="0.1"/></body></worldbody></mujoco>'


def test_a_second_model_in_one_file_is_refused(tmp_path):
    """MuJoCo reads the first."""
    (tmp_path / "part.xml").write_text("<mujocoinclude/><mujocoinclude><body/></mujocoinclude>", encoding="utf-8")
    (tmp_path / "whole.xml").write_text(MJCF.format('<include file="part.xml"/>'), encoding="utf-8")
    for source in (MJCF.format("") * 2, tmp_path / "whole.xml"):
        with pytest.raises(ModelError, match="not well-formed XML"):
            linkplan.load_mechanism(source)


def test_closures_and_motors_of_an_attached_urdf_are_named(tmp_path):
    (tmp_path / "leg.urdf").write_text(WHOLE, encoding="utf-8")
    place = tmp_path / "robot.xml"
    attached = (
        '<asset><model name="leg" file="leg.urdf"/></asset><worldbody><frame><attach model="leg" prefix="l_"/></frame>'
    )
    place.write_text(f"<mujoco>{attached}</worldbody></mujoco>", encoding="utf-8")
    mechanism = linkplan.load_mechanism(place)
    assert mechanism.dof == 3
    assert any("'leg.urdf'" in note and "loop_joint B, <transmission>" in note for note in mechanism.notes), mechanism.notes
