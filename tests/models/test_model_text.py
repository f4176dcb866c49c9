"""A URDF's loops and motors are read from the same XML elements that MuJoCo's reader finds, or the file is refused."""

import pytest

import linkplan
from linkplan.models.errors import ModelError
from tests.support.four_bar_urdf import FOUR_BAR, LOOP_JOINT, TRANSMISSION, robot

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
    with pytest.raises(ModelError) as refused:
        linkplan.load_mechanism(place)
    assert "\n" not in str(refused.value)
    assert "robot.urdf" in str(refused.value)


def test_the_place_that_is_not_well_formed_is_named(tmp_path):
    place = tmp_path / "robot.urdf"
    place.write_text("<!-- two\nlines -- -->\n" + REFUSED["a control character"], encoding="utf-8")
    with pytest.raises(ModelError, match="line 3, column"):
        linkplan.load_mechanism(place)


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
