"""Anchors beside their hinge's axis, as exporters round and displace them: they are moved along it, and said to be."""

import re

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import UnassembledError
from linkplan.models.library import built_in_text
from linkplan.models.selected_model import whole_model_text

KNEE = built_in_text("optimus-knee")
# The same four-bar whose pin is a connect between bodies; with a place for the anchor's offset along the axis.
BETWEEN_BODIES = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <worldbody>
    <body name="thigh" euler="20 0 35">
      <body name="crank">
        <joint name="O" axis="0 1 0" range="-80 80"/>
        <inertial pos="0 0 0.02" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
        <body name="coupler" pos="0 {offset} 0.06">
          <joint name="A" axis="{axis}"/>
          <inertial pos="0.03 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
        </body>
      </body>
      <body name="rocker" pos="0.07 0 0">
        <joint name="C" axis="0 1 0"/>
        <inertial pos="0 0 0.04" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
        <site name="end of rocker" pos="0 {site} 0.08"/>
      </body>
    </body>
  </worldbody>
  <equality>{equality}</equality>
  <actuator><motor joint="O" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
BY_BODIES = '<connect name="pin" body1="coupler" body2="rocker" anchor="0.07 {anchor} 0.02"/>'


def knee(offset_m: float) -> str:
    """Return the built-in knee with its rocker's pin beside the plane of the linkage."""
    moved = re.sub(r'(<site name="B_rocker"[^>]*pos="[-\d.e]+) [-\d.e]+ ', rf"\1 {offset_m!r} ", KNEE)
    assert moved != KNEE
    return moved


@pytest.mark.parametrize("offset_m", [1e-9, 1e-8, 1e-6, 1e-4, -1e-3, 4e-3])
def test_an_anchor_beside_the_plane_of_its_loop_is_moved_into_it(offset_m):
    exact, moved = linkplan.load_mechanism(KNEE), linkplan.load_mechanism(knee(offset_m))
    (note,) = [note for note in moved.notes if "moved by" in note]
    assert note.startswith(f"anchor of closure B moved by {1e3 * abs(offset_m):.3g} mm along its hinge's axis")
    assert moved.dof == 1
    assert moved.gap_m(moved.home) < 1e-15
    np.testing.assert_allclose(moved.home, exact.home, atol=1e-12)
    inertia = [float(np.array(one.dynamics.reduced_inertia(one.home)).item()) for one in (exact, moved)]
    assert inertia[1] == pytest.approx(inertia[0], rel=1e-12)


def test_an_exact_model_is_not_touched():
    mechanism = linkplan.load_mechanism(KNEE)
    assert not [note for note in mechanism.notes if "moved by" in note]
    assert mechanism.shifted == ()


def test_a_site_that_closes_a_loop_with_a_tilted_base_is_moved_in_its_body_s_frame():
    equality = '<connect name="pin" site1="end of coupler" site2="end of rocker"/>'
    text = BETWEEN_BODIES.format(offset=0.0, axis="0 1 0", site=0.002, equality=equality)
    text = text.replace('mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>\n        </body>', _END_OF_COUPLER)
    mechanism = linkplan.load_mechanism(text)
    assert mechanism.gap_m(mechanism.home) < 1e-15
    place = mechanism.model.site("end of rocker").pos
    np.testing.assert_allclose(place, [0.0, 0.0, 0.08], atol=1e-15)


_END_OF_COUPLER = (
    'mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>\n          <site name="end of coupler" pos="0.07 0 0.02"/>\n        </body>'
)


def test_axes_that_are_parallel_to_rounding_count_as_parallel():
    tilted = BETWEEN_BODIES.format(offset=0.0, axis="2e-7 1 0", site=0.0, equality=BY_BODIES.format(anchor=0.0))
    assert linkplan.load_mechanism(tilted).dof == 1


def test_the_anchor_of_each_loop_is_moved():
    pin = '<connect name="pin" site1="end of coupler" site2="end of rocker"/>'
    text = BETWEEN_BODIES.format(offset=0.0, axis="0 1 0", site=0.002, equality=pin)
    text = text.replace('mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>\n        </body>', _END_OF_COUPLER)
    (first,) = re.findall(r'<body name="crank">.*</body>(?=\s*</body>\s*</worldbody>)', text, flags=re.DOTALL)
    for part in (first, pin):
        text = text.replace(part, part + re.sub(r'(name|site1|site2)="(.*?)"', r'\1="\2 2"', part))
    mechanism = linkplan.load_mechanism(text)
    assert len([note for note in mechanism.notes if "moved by 2 mm" in note]) == 2
    assert mechanism.gap_m(mechanism.home) < 1e-15


def test_the_written_model_has_the_moved_anchor():
    mechanism = linkplan.load_mechanism(knee(1e-3))
    again = linkplan.load_mechanism(whole_model_text(mechanism))
    assert again.shifted == ()
    np.testing.assert_allclose(again.home, mechanism.home, atol=1e-12)


def test_a_larger_offset_names_the_tolerance_that_accepts_it():
    with pytest.raises(
        UnassembledError, match=r"along its hinge's axis.*mechanism\.closure_tolerance_m = 0\.0\d+"
    ) as refused:
        linkplan.load_mechanism(knee(0.02))
    tolerance = float(re.search(r"closure_tolerance_m = ([\d.]+)", str(refused.value))[1])
    accepted = linkplan.load_mechanism(knee(0.02), closure_tolerance_m=tolerance)
    assert accepted.dof == 1
    assert any("moved by 20 mm" in note for note in accepted.notes)
