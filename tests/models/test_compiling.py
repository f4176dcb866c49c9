"""What MuJoCo's compiler cannot name is a refusal all the same."""

import mujoco
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.library import compile_model

HINGE = '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body></worldbody></mujoco>'


def test_what_the_compiler_cannot_name_is_a_refusal(monkeypatch):
    def failing(_):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr(mujoco.MjSpec, "compile", failing)
    with pytest.raises(ModelError, match="does not compile"):
        compile_model(HINGE)
