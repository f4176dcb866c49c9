"""What a model asks for is known before MuJoCo makes it: repeated bodies, pictures, files in files, however it says so."""

import struct

import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.model_size import elements_of, size_of
from tests.support.refusals import assert_names, refusal

BODY = '<body name="{0}"><joint name="{0}" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>{1}</body>'


def model(inside: str = "", asset: str = "", name: str = "b") -> str:
    return f'<mujoco model="m"><asset>{asset}</asset><worldbody>{BODY.format(name, inside)}</worldbody></mujoco>'


# name: (MJCF, words of the refusal); each took minutes or gigabytes before it was refused
TOO_LARGE = {
    "a count in character references": (model('<replicate count="&#57;99999"><site/></replicate>'), ["count", "999999"]),
    "a count in hexadecimal": (model('<replicate count="0x98967f"><site/></replicate>'), ["count", "0x98967f"]),
    "a flex of many points": (model('<flexcomp name="f" count="4000 4000 1"/>'), ["1.6e+07 bodies"]),
    "replicates in replicates": (
        model('<replicate count="99"><replicate count="99"><body/></replicate></replicate>'),
        ["9802 bodies"],
    ),
    "sites by the million": (
        model('<replicate count="1000"><replicate count="1000"><site/></replicate></replicate>'),
        ["1e+06 sites"],
    ),
    "sites by the thousand": (model("<site/>" * 10_001), ["10001 sites"]),
    "geoms by the million": (
        model('<replicate count="1000"><replicate count="1000"><geom size="1"/></replicate></replicate>'),
        ["elements", "replicate"],
    ),
    "replicates that character data only seem to close": (
        model(
            '<replicate count="99"><replicate count="99"><![CDATA[</replicate></replicate>]]><body/></replicate></replicate>'
        ),
        ["9802 bodies"],
    ),
    "a cube's six sides": (model(asset='<texture width="16384" builtin="flat"/>'), ["textures"]),
    "many pictures": (model(asset='<texture type="2d" width="8192" height="8192" builtin="flat"/>' * 4), ["textures"]),
    "a sensor of a billion numbers": (
        '<mujoco><sensor><user name="u" dim="1000000000"/></sensor></mujoco>',
        ["dim", "1000000000"],
    ),
    "a mesh of nine million points": (
        model(asset='<mesh name="m" builtin="supersphere" params="3000 1 1"/>'),
        ["params", "3000"],
    ),
    "steps of two billion iterations": (
        '<mujoco><option iterations="2000000000" tolerance="0"/></mujoco>',
        ["iterations", "2000000000"],
    ),
    "shadows of a million pixels a side": (
        '<mujoco><visual><quality shadowsize="1000000"/></visual></mujoco>',
        ["shadowsize", "1000000"],
    ),
    "many height fields": (model(asset='<hfield nrow="4096" ncol="4096" size="1 1 1 1"/>' * 4), ["height fields"]),
}


@pytest.mark.parametrize(("text", "words"), TOO_LARGE.values(), ids=TOO_LARGE)
def test_a_model_that_asks_for_too_much_is_refused_before_it_is_made(text, words):
    assert_names(refusal(lambda: load_mechanism(text)), *words)


def test_replicates_beside_each_other_add_and_those_within_multiply():
    beside = '<replicate count="9"><body/></replicate><replicate count="8"><body/></replicate>'
    within = '<replicate count="9"><replicate count="8"><body/></replicate><body/></replicate>'
    assert size_of(list(elements_of(beside.encode()))).bodies == 17
    assert size_of(list(elements_of(within.encode()))).bodies == 81


def test_what_stands_in_a_comment_or_in_a_value_is_no_element():
    text = b"<!-- <body/> --><a b=\"<body/>\" c='>'/><body/>"
    assert [element.name for element in elements_of(text)] == ["a", "body"]


@pytest.mark.parametrize("part", ["<!--", "<a>", "<![CDATA[", "<?", "</b>", '<a b="', "<a b='", "<a b=", "</"])
def test_a_text_of_broken_parts_is_looked_through_in_one_pass(part):
    assert len(list(elements_of(b"<c>" + part.encode() * 100_000))) <= 100_001


def test_an_asset_whose_name_no_system_takes_is_not_found(tmp_path):
    (tmp_path / "m.xml").write_text(model(asset=f'<mesh name="q" file="{"q" * 300}.stl"/>'))
    assert_names(refusal(lambda: load_mechanism(tmp_path / "m.xml")), "m.xml", "Error opening file")


def test_bodies_side_by_side_by_the_thousand_are_read():
    many = '<replicate count="300" offset="1 0 0"><geom size="0.1"/></replicate>' * 2
    assert load_mechanism(model(many)).dof == 1


# Files in files


def test_a_model_that_attaches_itself_is_refused(tmp_path):
    path = tmp_path / "self.xml"
    attach = '<attach model="o" body="b" prefix="x"/>'
    path.write_text(model(attach, '<model name="o" file="self.xml"/>'))
    assert_names(refusal(lambda: load_mechanism(path)), "self.xml", "circle")


def test_models_that_attach_each_other_twice_a_file_are_counted(tmp_path):
    twice = '<attach model="o" body="b" prefix="x"/><attach model="o" body="b" prefix="y"/>'
    for k in range(16):
        (tmp_path / f"{k}.xml").write_text(model(twice, f'<model name="o" file="{k + 1}.xml"/>'))
    (tmp_path / "16.xml").write_text(model())
    assert_names(refusal(lambda: load_mechanism(tmp_path / "0.xml")), "0.xml", "bodies")
    assert load_mechanism(tmp_path / "13.xml").dof == 15


@pytest.mark.parametrize("name", ["more.inc", "more", "a &amp; b.xml"])
def test_an_included_file_of_any_name_is_looked_into(name, tmp_path):
    (tmp_path / name.replace("&amp;", "&")).write_text(model('<replicate count="20000"><site/></replicate>'))
    (tmp_path / "m.xml").write_text(f'<mujoco><include file="{name}"/></mujoco>')
    assert_names(refusal(lambda: load_mechanism(tmp_path / "m.xml")), "count", "20000")


def test_a_picture_that_unfolds_to_gigabytes_is_refused(tmp_path):
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 30_000, 30_000, 8, 2, 0, 0, 0)
    (tmp_path / "sky.png").write_bytes(head)
    (tmp_path / "m.xml").write_text(model(asset='<texture name="sky" type="2d" file="sky.png"/>'))
    with pytest.raises(ModelError, match="30000 x 30000 pixels"):
        load_mechanism(tmp_path / "m.xml")
