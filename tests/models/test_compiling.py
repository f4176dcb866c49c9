"""A model that MuJoCo's compiler would never be done with is refused, and one that it can make is made as ever."""

import mujoco
import pytest

from linkplan.models.compiling import bounded
from linkplan.models.errors import ModelError
from linkplan.models.library import compile_model

MUSCLE = """<mujoco><compiler>{0}</compiler><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
</body></worldbody><actuator><muscle name="m" joint="j" ctrlrange="0 1"/></actuator></mujoco>"""
# Ten billion steps for one muscle.
ENDLESS = MUSCLE.format('<lengthrange timestep="1e-9" inttotal="10"/>')


def test_a_muscle_whose_length_is_looked_for_without_end_is_ended():
    with pytest.raises(RuntimeError, match="lengthrange"), bounded(0.05):
        mujoco.MjSpec.from_string(ENDLESS).compile()


def test_what_ends_in_time_is_the_same_model_as_without_a_bound():
    limited = MUSCLE.format("").replace('axis="0 1 0"', 'axis="0 1 0" range="-60 60"')
    free = mujoco.MjModel.from_xml_string(limited)
    assert compile_model(limited)[1].actuator_lengthrange == pytest.approx(free.actuator_lengthrange, abs=0.0)
    assert mujoco.get_mjcb_time() is None


def test_what_the_compiler_cannot_name_is_a_refusal(monkeypatch):
    def failing(_):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr(mujoco.MjSpec, "compile", failing)
    with pytest.raises(ModelError, match="does not compile"):
        compile_model(MUSCLE.format(""))
