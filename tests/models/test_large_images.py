"""Textures too large for memory are left out and named, since no plan needs them; height fields are refused."""

import struct

import pytest

import linkplan
from linkplan.models.errors import ModelError

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
