"""Refusals: ours, in one line, with words that must be in it; and a model of two bodies to refuse."""

from collections.abc import Callable

import pytest

from linkplan.models.errors import LinkplanError, ModelError

# Two bodies that nothing joins but a fixed tendon; what `%s` stands for goes to the model's own level.
TWO_BODIES = """
<mujoco model="two"><compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="left"><joint name="ja" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/><site name="sa" pos="0.1 0 0"/></body>
    <body name="right" pos="5 0 0"><joint name="jb" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>
  </worldbody>
  <tendon><fixed name="cable"><joint joint="ja" coef="1"/><joint joint="jb" coef="2"/></fixed></tendon>
  %s
</mujoco>"""


def refusal(action: Callable[[], object], kind: type[LinkplanError] = ModelError) -> str:
    """Return the message of the refusal, which is ours and one line."""
    with pytest.raises(LinkplanError) as refused:
        action()
    message = str(refused.value)
    assert isinstance(refused.value, kind)
    assert message.strip()
    assert len(message.splitlines()) == 1, f"not one line: {message!r}"
    return message


def assert_names(message: str, *words: str) -> None:
    """Fail where a message lacks one of the words."""
    missing = [word for word in words if word not in message]
    assert not missing, f"{missing} not in: {message}"


def assert_refused(action: Callable[[], object], *words: str, kind: type[LinkplanError] = LinkplanError) -> None:
    """Fail unless an action is refused by an error of a kind, in one line with all of the words."""
    assert_names(refusal(action, kind), *words)
