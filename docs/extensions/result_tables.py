"""Directive `result-table`: a CSV of `benchmarks/results` as a table, with the command and the machine that made it.

```{result-table} four_bar_runs.csv
:columns: case, rtol, milliseconds, steps, error_m
:where: rtol=1e-08
```
"""

import csv
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results"


class ResultTable(Directive):
    """The table, the command above it, the machine and the versions below it."""

    required_arguments = 1
    option_spec = {"columns": directives.unchanged, "where": directives.unchanged}

    def run(self) -> list[nodes.Node]:
        """Read, choose, and write out."""
        path = RESULTS / self.arguments[0]
        self.state.document.settings.record_dependencies.add(str(path))
        comments, rows = read(path)
        rows = chosen(rows, self.options.get("where", ""), path)
        columns = (
            [name.strip() for name in self.options["columns"].split(",")]
            if "columns" in self.options
            else None
        )
        columns = columns or list(rows[0])
        unknown = [name for name in columns if name not in rows[0]]
        if unknown:
            raise SphinxError(
                f"{path.name} has no column {unknown[0]!r}; it has {', '.join(rows[0])}"
            )
        return [
            command_of(comments),
            scrolled(table_of(columns, rows)),
            made_with(comments),
        ]


def read(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Comments at the head, and rows by column."""
    lines = path.read_text().splitlines()
    comments = [line.removeprefix("# ") for line in lines if line.startswith("#")]
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    if not rows or not comments:
        raise SphinxError(f"{path.name}: no rows, or no command at its head")
    return comments, rows


def chosen(rows: list[dict[str, str]], where: str, path: Path) -> list[dict[str, str]]:
    """Rows that have all the values asked for, `column=value; column=value`."""
    for condition in filter(None, (part.strip() for part in where.split(";"))):
        name, _, value = condition.partition("=")
        rows = [row for row in rows if row[name] == value]
        if not rows:
            raise SphinxError(f"{path.name}: no row with {condition}")
    return rows


def command_of(comments: list[str]) -> nodes.Node:
    """The command that made the numbers."""
    return nodes.literal_block(comments[0], comments[0], language="console")


def made_with(comments: list[str]) -> nodes.Node:
    """Machine and versions."""
    text = "; ".join(comments[1:])
    return nodes.paragraph("", "", nodes.inline(text, text), classes=["made-with"])


def table_of(columns: list[str], rows: list[dict[str, str]]) -> nodes.table:
    """Rows as a table."""
    group = nodes.tgroup(cols=len(columns))
    group += [nodes.colspec(colwidth=1) for _ in columns]
    group += nodes.thead("", row_of([name.replace("_", " ") for name in columns]))
    group += nodes.tbody("", *(row_of([row[name] for name in columns]) for row in rows))
    return nodes.table("", group, classes=["results"])


def row_of(cells: list[str]) -> nodes.row:
    """One row."""
    return nodes.row(
        "", *(nodes.entry("", nodes.paragraph(cell, cell)) for cell in cells)
    )


def scrolled(table: nodes.table) -> nodes.container:
    """A table that scrolls sideways in a narrow window."""
    return nodes.container("", table, classes=["scrolled"])


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("result-table", ResultTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
