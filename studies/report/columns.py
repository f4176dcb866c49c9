"""Columns of a table, written as people read them."""


def columns(*heads: str) -> list[tuple[str, str]]:
    """Return columns (head, unit) of heads like "phase margin [deg]"; for heads of this program's own, not for names."""
    found = []
    for head in heads:
        text, bracket, unit = head.partition(" [")
        found.append((text, unit.removesuffix("]") if bracket else ""))
    return found
