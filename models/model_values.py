"""What no compiled model may hold: names that are no text, and numbers that are not finite or mean nothing.

MuJoCo's compiler warns of NaN and passes on most else: infinite masses, negative armatures, ranges from high to low.
"""

from collections.abc import Iterator

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, one_line
from linkplan.models.reading import shown

# No quantity of a mechanism is larger, in SI units; MuJoCo's own bound on states is 1e10, and solver parameters are below.
MAX_SI_VALUE = 1e12
# Longer names are no names: pages and tables show them.
MAX_NAME_LENGTH = 500
# Fields of a compiled model that are not below zero, by what they are.
_NOT_NEGATIVE = {
    "body_mass": "mass", "body_inertia": "inertia", "dof_armature": "armature", "dof_frictionloss": "frictionloss",
    "dof_damping": "damping", "tendon_frictionloss": "frictionloss", "tendon_damping": "damping",
    "tendon_armature": "armature", "actuator_armature": "armature", "actuator_damping": "damping",
}  # fmt: skip
# What the compiler works out of the others, for its own scaling: huge where something is nearly massless.
_DERIVED = ("oct_coeff", "actuator_acc0", "body_invweight0", "dof_invweight0", "tendon_invweight0")
# The simulator's step [s]: below the first no computer gets anywhere, above the last nothing moves as it should.
TIMESTEP_RANGE_S = (1e-8, 1.0)
# Which of mjModel's names a field's prefix has, for a refusal that names the element.
_OWNERS = {
    "body": "body", "jnt": "joint", "geom": "geom", "site": "site", "tendon": "tendon", "actuator": "actuator",
    "eq": "equality", "key": "key", "mesh": "mesh", "cam": "camera", "sensor": "sensor",
}  # fmt: skip
_KINDS = {
    "body": mujoco.mjtObj.mjOBJ_BODY, "joint": mujoco.mjtObj.mjOBJ_JOINT, "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE, "tendon": mujoco.mjtObj.mjOBJ_TENDON, "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "equality": mujoco.mjtObj.mjOBJ_EQUALITY, "key": mujoco.mjtObj.mjOBJ_KEY, "mesh": mujoco.mjtObj.mjOBJ_MESH,
    "camera": mujoco.mjtObj.mjOBJ_CAMERA, "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
}  # fmt: skip


def refuse_unusable(name: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model that holds names that are no text, or numbers that are not finite or mean nothing.

    Raises:
        ModelError: naming the element and the field.
    """
    _refuse_names(name, model)
    step = float(model.opt.timestep)
    if not TIMESTEP_RANGE_S[0] <= step <= TIMESTEP_RANGE_S[1]:
        raise ModelError(
            f"model '{name}' has option timestep = {step:g} s; the simulator's step is from {TIMESTEP_RANGE_S[0]:g} to"
            f" {TIMESTEP_RANGE_S[1]:g} s"
        )
    for field, word in _NOT_NEGATIVE.items():
        value = getattr(model, field, None)
        if value is not None and np.any(np.asarray(value) < 0):
            bad = np.asarray(value) < 0
            raise ModelError(
                f"model '{name}' has {_where(model, field, bad)} = {float(np.asarray(value)[bad].ravel()[0]):g}; {word}"
                " is at least 0"
            )
    for field in ("jnt_range", "tendon_range", "actuator_ctrlrange", "actuator_forcerange", "jnt_actfrcrange"):
        value = np.asarray(getattr(model, field, np.zeros((0, 2)))).reshape(-1, 2)
        bad = value[:, 0] > value[:, 1]
        if np.any(bad):
            low, high = value[bad][0]
            raise ModelError(f"model '{name}' has {_where(model, field, bad)} = {low:g} to {high:g}, which is no range")
    for what, value in _numbers(model):
        bad = ~np.isfinite(value) | (np.abs(value) > MAX_SI_VALUE)
        if np.any(bad):
            got = float(value[bad].ravel()[0])
            legal = "not finite (nan or inf)" if not np.isfinite(got) else f"beyond {MAX_SI_VALUE:g}"
            raise ModelError(f"model '{name}' holds a number that is {legal}: {_where(model, what, bad)} is {got:g}")


def _numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every array of floats of a model and of its options, by its name."""
    for owner, prefix in ((model, ""), (model.opt, "option ")):
        for field in dir(owner):
            if field.startswith("_") or field.endswith(("_user", "_numeric")) or field in _DERIVED:
                continue
            value = getattr(owner, field)
            if isinstance(value, float):
                yield prefix + field, np.array([value])
            elif isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
                yield prefix + field, value


def _refuse_names(name: str, model: mujoco.MjModel) -> None:
    for word in bytes(model.names).split(b"\0"):
        try:
            text = word.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ModelError(f"model '{name}' has a name that is not UTF-8 text: {word[:40]!r}") from error
        if len(text) > MAX_NAME_LENGTH:
            raise ModelError(
                f"model '{name}' has a name of {len(text)} characters, '{one_line(shown(text, 40))}'; names have at most"
                f" {MAX_NAME_LENGTH}"
            )
        if text and not text.isprintable():
            raise ModelError(
                f"model '{name}' has a name with characters that cannot be shown: '{one_line(shown(text, 60))}'"
            )


def _where(model: mujoco.MjModel, field: str, bad: np.ndarray) -> str:
    """Return a field's name and, where it belongs to elements, that of the first bad one."""
    prefix, _, rest = field.partition("_")
    row = int(np.argwhere(bad)[0][0])
    if prefix == "dof" and row < model.nv:
        prefix, row = "jnt", int(model.dof_jntid[row])
    kind = _OWNERS.get(prefix)
    if kind is None or not rest:
        return field
    try:
        element = mujoco.mj_id2name(model, _KINDS[kind], row)
    except (UnicodeDecodeError, TypeError):
        element = None
    return f"{rest} of {kind} {element or row}"
