"""Tables as a terminal shows them."""

import io

from rich.console import Console

from isacbench.report.table_texts import rich_table


def printed(grid):
    """Lines of a table in a terminal that is wider than any table, without blanks at their ends."""
    console = Console(width=300, record=True, file=io.StringIO())
    console.print(rich_table(grid))
    return [line.rstrip() for line in console.export_text().splitlines()]
