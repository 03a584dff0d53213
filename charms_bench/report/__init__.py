"""Tables, and the views that draw them: for a terminal, a page, a report, or a notebook."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from charms_bench.report.table import Table


def notebook_of(table: "Table") -> str:
    """A table as HTML, for a notebook."""
    from charms_bench.report.html.table import notebook

    return notebook(table)
