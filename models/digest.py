"""Hashes of the parts of a model that a plan depends on. They show later which part has changed.

Colours, cameras, contacts and the simulator's own settings are left out, because plans do not depend on them.
"""

import hashlib

import mujoco
import numpy as np

# Fields of mjModel (for the last part: of its options) that determine dynamics, closures, limits and transmissions.
_PARTS: dict[str, tuple[str, ...]] = {
    "bodies": (
        "body_parentid", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "body_gravcomp",
    ),
    "joints": (
        "jnt_type", "jnt_bodyid", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range", "jnt_margin", "jnt_stiffness",
        "jnt_stiffnesspoly",
        "dof_armature", "dof_damping", "dof_dampingpoly", "dof_frictionloss", "qpos0", "qpos_spring",
    ),
    "actuators": (
        "actuator_trntype", "actuator_trnid", "actuator_gear", "actuator_cranklength", "actuator_gaintype",
        "actuator_gainprm",
        "actuator_biastype", "actuator_biasprm", "actuator_dyntype", "actuator_dynprm", "actuator_ctrllimited",
        "actuator_ctrlrange", "actuator_forcelimited", "actuator_forcerange", "actuator_armature", "actuator_damping",
        "actuator_dampingpoly", "jnt_actfrclimited", "jnt_actfrcrange",
    ),
    "loop closures": ("eq_type", "eq_objtype", "eq_obj1id", "eq_obj2id", "eq_active0", "eq_data"),
    "tendons and sites": (
        "tendon_adr", "tendon_num", "tendon_limited", "tendon_range", "tendon_stiffness", "tendon_stiffnesspoly",
        "tendon_damping", "tendon_dampingpoly", "tendon_lengthspring", "tendon_armature", "wrap_type", "wrap_objid",
        "wrap_prm", "site_bodyid", "site_pos", "site_quat",
    ),
    "gravity and other options": ("gravity", "wind", "density", "viscosity", "disableflags"),
}  # fmt: skip
# Fields that earlier versions did not hash. They are left out if all values are zero, so that old hashes remain valid.
_ADDED_FIELDS = ("jnt_margin",)


def part_hashes(model: mujoco.MjModel) -> dict[str, str]:
    """Return a hash of each part of a compiled model, by the part's name.

    Fields that this MuJoCo does not have are left out, so only hashes of the same version of MuJoCo are comparable.
    """
    found = {}
    for part, fields in _PARTS.items():
        digest = hashlib.sha256()
        for field in fields:
            value = getattr(model.opt if part == "gravity and other options" else model, field, None)
            if value is not None and (field not in _ADDED_FIELDS or np.any(value)):
                array = np.array(value)
                digest.update(f"{field}{array.shape}".encode())
                # Nine digits: MuJoCo's compiler may round differently on other machines.
                digest.update(" ".join(f"{number + 0.0:.9g}" for number in array.ravel()).encode())
        if part == "tendons and sites":
            # The places and radii of the geoms that tendons wrap around.
            around = (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER))
            geoms = [int(geom) for kind, geom in zip(model.wrap_type, model.wrap_objid, strict=True) if int(kind) in around]
            of_geoms = (model.geom_bodyid, model.geom_pos, model.geom_quat, model.geom_size)
            numbers = [number for geom in geoms for field in of_geoms for number in np.ravel(field[geom])]
            digest.update(" ".join(f"{number + 0.0:.9g}" for number in numbers).encode())
        found[part] = digest.hexdigest()[:16]
    return found


def compiled_bytes(model: mujoco.MjModel) -> bytes:
    """Return a compiled model as bytes."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()
