"""Directive `notebooks`: the notebooks of the repository, each with its title, its first paragraph, and the file."""

import json
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"


def heading(path: Path) -> tuple[str, str]:
    """Title and first paragraph of a notebook."""
    first = json.loads(path.read_text())["cells"][0]
    lines = "".join(first["source"]).strip().split("\n\n")
    if (
        first["cell_type"] != "markdown"
        or not lines[0].startswith("# ")
        or len(lines) < 2
    ):
        raise SphinxError(f"{path.name} does not begin with a title and a paragraph")
    return lines[0].removeprefix("# "), lines[1].replace("\n", " ")


class Notebooks(Directive):
    """A paragraph for each, in the order of their files' names."""

    def run(self) -> list[nodes.Node]:
        """Write the list, and have it parsed."""
        lines: list[str] = []
        for path in sorted(FOLDER.glob("*.ipynb")):
            title, paragraph = heading(path)
            lines += [
                f"**{title}** ({{download}}`{path.name} <../notebooks/{path.name}>`)",
                "",
                paragraph,
                "",
            ]
        found = nodes.container()
        self.state.nested_parse(StringList(lines), self.content_offset, found)
        return found.children


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("notebooks", Notebooks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
