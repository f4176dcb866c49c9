"""Fixed tendons with so narrow a range that they couple their joints, as models of rolling joints and differentials do."""

import mujoco
import numpy as np

from linkplan.models.errors import listed


def couple_narrow_tendons(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Hold the length of each fixed tendon whose range couples its joints, and return a note on them.

    A range couples if it is less than 2 % of the lengths that the tendon has within the ranges of its joints. An equality
    in the middle of the range, as soft as the limit, takes the limit's place.
    """
    fixed = [tendon for tendon in spec.tendons if len(tendon.path) > 1 and _is_fixed(tendon) and np.ptp(tendon.range) > 0]
    model = spec.compile() if fixed else None
    coupled = []
    for tendon in fixed:
        low, high = model.tendon_range[tendon.id]
        joints = [(model.joint(wrap.target.name), wrap.coef) for wrap in tendon.path]
        stroke = sum(abs(coef) * np.ptp(joint.range) for joint, coef in joints if model.jnt_limited[joint.id])
        if model.tendon_limited[tendon.id] and high - low < 0.02 * stroke:
            tie = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_TENDON,
                objtype=mujoco.mjtObj.mjOBJ_TENDON,
                name1=tendon.name,
                solref=tendon.solref_limit,
                solimp=tendon.solimp_limit,
            )
            tie.data = np.eye(len(tie.data))[0] * ((low + high) / 2 - model.tendon_length0[tendon.id])
            tendon.limited = 0
            coupled.append(tendon.name)
    if not coupled:
        return ()
    return (f"the ranges of tendons {listed(coupled, 6)} leave their joints almost no play: they are held in the middle",)


def _is_fixed(tendon: "mujoco._specs.MjsTendon") -> bool:
    return all(wrap.type == mujoco.mjtWrap.mjWRAP_JOINT for wrap in tendon.path)
