"""What exported C code costs, as a document."""

from pathlib import Path

from linkplan.studies.output.document import Block, Text, table_of


def cost_blocks(record: dict, target: Path) -> list[Block]:
    """Return the record of an export to C as blocks."""
    found: list[Block] = [Text(text=f"{target}: {', '.join(record['files'])}", tone="good")]
    if "functions" in record:
        kinds = list(dict.fromkeys(kind for row in record["functions"] for kind in row["operations"]))
        rows = [
            [row["function"], *(row["operations"].get(kind, 0) for kind in kinds), row["float_error"]]
            for row in record["functions"]
        ]
        heads = ["operations of one call", *kinds, "error in float, share of the largest value"]
        found.append(table_of("", heads, rows, digits=2))
    else:
        text = f"{record['tracker']} at {record['instants']} instants every {record['period_s']:g} s"
        text += f", {record['table_numbers']} numbers"
        found.append(Text(text=text))
    if not record["sizes"]:
        text = "flash and stack are not measured: neither gcc nor arm-none-eabi-gcc is installed, or the code is too long"
        found.append(Text(text=text, tone="note"))
    rows = [[row["compiler"], row["real"], row["flash_bytes"], row["stack_bytes"]] for row in record["sizes"]]
    if rows:
        without = f", without {', '.join(record['sizes_without'])}" if record.get("sizes_without") else ""
        heads = ["compiler", "numbers", "flash [byte]", "largest stack frame [byte]"]
        found.append(table_of(f"Object code{without}", heads, rows))
    return found
