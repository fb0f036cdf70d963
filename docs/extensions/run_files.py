"""Directive `run-files`: the files that a page names, and how they import each other, drawn from their sources.

    ```{run-files}
    ```

A storey is a file, from those that import to those that are imported; an arrow ends at what is imported.
"""

import re
from collections import Counter
from pathlib import Path

import floors
from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

PATH = re.compile(r"`([\w/]+/[\w/]+\.py)(?:::\w+)?`")
NAMES, SHAFT = 335, 30
"""Width of the names of files, and from shaft to shaft, in pixels."""


def files_on(text: str) -> list[str]:
    """Files of the package that a page names, each once."""
    return [
        path
        for path in dict.fromkeys(PATH.findall(text))
        if (floors.PACKAGE / path).exists()
    ]


def drawn_from(text: str, package: Path = floors.PACKAGE) -> floors.House:
    """The files that a page names, from above to below, with their imports of each other.

    A file that reaches another one through files that are not named stands above it, too.
    """
    modules = {floors.module_of(path, package): path for path in package.rglob("*.py")}
    imports = {
        module: Counter(floors.imported(path.read_text(), set(modules)))
        for module, path in modules.items()
    }
    packages = {m for m, path in modules.items() if path.name == "__init__.py"}
    for module in modules:
        # What a folder's own file hands on is imported from where it stands.
        for passed in packages & set(imports[module]):
            imports[module] += imports[passed]
    named = {path: floors.module_of(package / path, package) for path in files_on(text)}
    depth: dict[str, int] = {}

    def depth_of(module: str) -> int:
        if module not in depth:
            depth[module] = 0  # a circle, which another test refuses, would not end
            depth[module] = 1 + max(map(depth_of, imports[module]), default=0)
        return depth[module]

    order = sorted(named, key=lambda path: -depth_of(named[path]))
    counts = Counter(
        {
            (one, other): min(imports[named[one]][named[other]], 1)
            for one in order
            for other in order
            if one != other
        }
    )
    sizes = {
        path: (1, len((package / path).read_text().splitlines())) for path in order
    }
    return floors.House(tuple(order), sizes, +counts)


class RunFiles(Directive):
    """The picture."""

    def run(self) -> list[nodes.Node]:
        """Read the page and its files, and draw."""
        text = Path(self.state.document["source"]).read_text()
        for path in files_on(text):
            self.state.document.settings.record_dependencies.add(
                str(floors.PACKAGE / path)
            )
        picture = nodes.raw(
            "", floors.svg(drawn_from(text), NAMES, SHAFT), format="html"
        )
        return [nodes.container("", picture, classes=["scrolled", "floors"])]


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("run-files", RunFiles)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
