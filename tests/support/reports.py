"""Documents of reports taken apart."""

from collections.abc import Iterator

from linkplan.studies.output.document import Block, Report


def blocks(report: Report, kind: type[Block]) -> list:
    """Return the blocks of a kind, in their order, after making sure that there are any."""
    found = [block for section in report.sections for block in section.blocks if isinstance(block, kind)]
    assert found, kind.__name__
    return found


def texts(value: object) -> Iterator[str]:
    """Yield every text of a record."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from texts(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from texts(item)
