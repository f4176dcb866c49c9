"""Sites of a model: named points fixed to its bodies, and their positions in the world."""

import casadi as ca
import mujoco

from linkplan.models.errors import ModelError
from linkplan.models.names import nearest
from linkplan.models.tree.dynamics import Tree


def site_places(tree: Tree) -> ca.SX:
    """Return the world positions (3, n_sites) [m] of a model's sites as expressions of q."""
    model = tree.model
    points = [tree.point(int(model.site_bodyid[site]), model.site_pos[site]) for site in range(model.nsite)]
    return ca.horzcat(ca.SX(3, 0), *points)


def site_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of a model's named sites in file order."""
    return tuple(name for name in (model.site(site).name for site in range(model.nsite)) if name)


def site_index(model: mujoco.MjModel, name: str, what: str, error: type[Exception] = ModelError) -> int:
    """Return a site's index by name.

    Raises:
        error: if there is no such site; the message contains `what` and lists the sites.
    """
    names = site_names(model)
    if name in names:
        return int(model.site(name).id)
    known = (
        f"sites are {', '.join(names)}" if names else "the model names none; a point of a body is <site name=... pos=.../>"
    )
    raise error(f"unknown site '{name}' in {what}{nearest(name, names)}; {known}")
