"""Models whose meshes and textures were not published with them."""

import base64

import mujoco
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.library import compile_model
from linkplan.models.mechanism import load_mechanism

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
    assert note.startswith("files that are not there are left out with what they draw: shell.stl")
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


def test_a_mesh_whose_mass_a_body_needs_is_not_left_out(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=""))
    with pytest.raises(ModelError, match=r"body 'arm' has its mass from mesh 'shell\.stl'.*<inertial>"):
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


def test_a_git_lfs_pointer_whose_mass_a_body_needs_is_named_with_its_remedy(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(inertial=""))
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "shell.stl").write_text(POINTER)
    with pytest.raises(ModelError, match=r"body 'arm' has its mass from mesh 'shell\.stl'.*git lfs pull"):
        compile_model(file)


def test_contact_pairs_with_a_floor_of_another_file_are_left_out_and_named(tmp_path):
    file = tmp_path / "arm.xml"
    body = '<body name="leg"><joint axis="0 1 0"/><geom name="foot" size=".1"/></body>'
    excluded = '<exclude body1="terrain" body2="leg"/><exclude body1="world" body2="leg"/>'
    pair = f'<contact><pair geom1="floor" geom2="foot"/>{excluded}</contact>'
    file.write_text(f"<mujoco><worldbody>{body}</worldbody>{pair}</mujoco>")
    _, model, notes = compile_model(file)
    assert (model.npair, model.nexclude) == (0, 1)
    assert notes[0].endswith("geoms or bodies of other files are left out: floor, terrain")


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
    with pytest.raises(ModelError, match="unrecognized attribute: 'newrate'"):
        compile_model(file)
