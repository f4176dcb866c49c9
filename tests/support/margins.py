"""The margins of a certificate by joint."""

from msgspec.structs import replace

from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.limits.limit import Margin


def margin_of(certificate: Certificate, what: str, joint: int) -> Margin:
    """Return the margin of a joint to its range ("position") or to its speed limit ("speed")."""
    (found,) = [margin for margin in certificate.margins if (margin.what, margin.item) == (what, joint)]
    return found


def with_margin(certificate: Certificate, what: str, joint: int, **changes: object) -> Certificate:
    """Return a certificate with another margin of one joint."""
    old = margin_of(certificate, what, joint)
    margins = tuple(replace(one, **changes) if one is old else one for one in certificate.margins)
    return replace(certificate, margins=margins)


def other_margins(certificate: Certificate) -> list[Margin]:
    """Return the margins other than those of efforts and of joints' ranges and speeds."""
    return [margin for margin in certificate.margins if margin.what not in ("effort", "position", "speed")]
