"""Columns of a table from heads with units."""


def columns(*heads: str) -> list[tuple[str, str]]:
    """Return columns (head, unit) of heads like "phase margin [deg]". Names of a model are not heads."""
    found = []
    for head in heads:
        text, bracket, unit = head.partition(" [")
        found.append((text, unit.removesuffix("]") if bracket else ""))
    return found
