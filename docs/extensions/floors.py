"""Directive `floors`: the floors of the package and how they import each other, drawn from its sources.

    ```{floors}
    ```

Nothing is written down twice: a floor is a folder, an arrow is as many import statements as its number says. A build
fails where an import goes up, or where a folder has no floor.
"""

import ast
from collections import Counter
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

PACKAGE = Path(__file__).resolve().parents[2] / "spherejax"
ORDER = (
    "compiler",
    "program_cache",
    "runtime",
    "foundations",
    "physics",
    "model",
    "gallery",
    "motion",
    "files",
    "output",
    "studies",
    "command_line",
    "top",
)
"""From below upwards; `top` are the files beside the folders. A test holds the imports to it."""

RUNTIME = "runtime.py"
"""It sets up the process. A file, and not a folder: it joins the two lowest floors, and all others may stand on it."""

SHOWN = {"top": "spherejax", "runtime": "runtime.py"}


class House(NamedTuple):
    """What is drawn.

    Attributes:
        floors: names from above to below.
        sizes: files and lines of each floor.
        imports: import statements from one floor to another.
    """

    floors: tuple[str, ...]
    sizes: dict[str, tuple[int, int]]
    imports: Counter[tuple[str, str]]


def house(package: Path = PACKAGE, order: tuple[str, ...] = ORDER) -> House:
    """Read the sources of a package.

    Raises:
        SphinxError: for an import that goes up, and for a folder without a floor.
    """
    floors = tuple(reversed(order))
    files = {module_of(path, package): path for path in sorted(package.rglob("*.py"))}
    floor = {module: floor_of(path, package) for module, path in files.items()}
    unknown = sorted(set(floor.values()) - set(floors))
    if unknown:
        raise SphinxError(
            f"the folder {unknown[0]} of {package.name} has no floor in docs/extensions/floors.py"
        )
    imports: Counter[tuple[str, str]] = Counter()
    sizes = dict.fromkeys(floors, (0, 0))
    for module, path in files.items():
        own = floor[module]
        n_files, n_lines = sizes[own]
        text = path.read_text()
        sizes[own] = n_files + 1, n_lines + len(text.splitlines())
        for name in imported(text, set(files)):
            other = floor[name]
            if own == "command_line" and name == package.name:
                continue  # the command line is a user of the public names
            if floors.index(other) < floors.index(own):
                raise SphinxError(f"{path} imports upwards: {name}")
            imports[own, other] += own != other
    return House(floors, sizes, +imports)


def module_of(path: Path, package: Path) -> str:
    """The name under which a file is imported."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def floor_of(path: Path, package: Path) -> str:
    """The floor that a file stands on."""
    parts = path.relative_to(package).parts
    return parts[0] if len(parts) > 1 else "runtime" if parts[0] == RUNTIME else "top"


def imported(text: str, modules: set[str]) -> Iterator[str]:
    """Modules of the package that a file imports, one for each statement and module, those for types included."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            parts = full & modules
            yield from sorted(parts)
            if full - modules and node.module in modules:
                yield str(node.module)


# The picture: a storey for each floor, and a shaft from each one down to the lowest that it stands on ----------------

STOREY, NAMES, SHAFT = 46, 196, 50
"""Height of a storey, width of the names, and from shaft to shaft, in pixels."""


def svg(drawn: House, names: int = NAMES, between: int = SHAFT) -> str:
    """The picture, in the color of the text around it.

    Args:
        drawn: what is drawn.
        names: width of the names.
        between: from shaft to shaft.
    """
    floors, n = drawn.floors, len(drawn.floors)
    width, height = names + between * (n - 1) + 26, STOREY * n + 2
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'role="img" font-family="inherit" fill="currentColor" stroke="none">',
        f"<title>{escape(words(drawn))}</title>",
    ]
    for row, name in enumerate(floors):
        y = 1 + row * STOREY
        n_files, n_lines = drawn.sizes[name]
        size = (
            f"{n_lines:,} lines"
            if n_files == 1
            else f"{n_files} files, {n_lines:,} lines"
        )
        parts += [
            f'<rect x="1" y="{y}" width="{width - 2}" height="{STOREY}" fill="currentColor" '
            f'fill-opacity="{0.07 if row % 2 else 0.02}" stroke="currentColor" stroke-opacity="0.35"/>',
            text_at(
                12, y + 20, SHOWN.get(name, name), 'font-size="15" font-weight="600"'
            ),
            text_at(12, y + 37, size, 'font-size="11.5" fill-opacity="0.75"'),
        ]
    for row, name in enumerate(floors[:-1]):
        parts += shaft(drawn, row, name, names + between * row)
    return "\n".join([*parts, "</svg>"])


def shaft(drawn: House, row: int, name: str, x: float) -> list[str]:
    """From a floor down to the lowest one that it imports, with a number at each that it imports."""
    stops = [
        (below, drawn.imports[name, other])
        for below, other in enumerate(drawn.floors)
        if below > row and drawn.imports[name, other]
    ]
    if not stops:
        return []
    top, bottom = middle(row), middle(stops[-1][0])
    parts = [
        f'<line x1="{x}" y1="{top}" x2="{x}" y2="{bottom - 6}" stroke="currentColor" stroke-opacity="0.5" '
        'stroke-width="1.4"/>',
        f'<circle cx="{x}" cy="{top}" r="5"/>',
    ]
    for below, count in stops:
        y = middle(below)
        parts += [
            f'<path d="M{x - 5} {y - 8} L{x + 5} {y - 8} L{x} {y + 2} Z"/>',
        ]
        if max(drawn.imports.values()) > 1:
            parts.append(text_at(x + 8, y + 4, str(count), 'font-size="12.5"'))
    return parts


def middle(row: int) -> float:
    """Half the height of a storey."""
    return 1 + STOREY * (row + 0.5)


def text_at(x: float, y: float, text: str, look: str) -> str:
    """A text."""
    return f'<text x="{x}" y="{y}" {look}>{escape(text)}</text>'


def words(drawn: House) -> str:
    """What the picture shows, for those who do not see it."""
    sentences = []
    for name in drawn.floors[:-1]:
        counts = [
            f"{SHOWN.get(other, other)} {drawn.imports[name, other]}"
            for other in drawn.floors
            if drawn.imports[name, other]
        ]
        sentences.append(
            f"{SHOWN.get(name, name)} imports {', '.join(counts) or 'no floor'}"
        )
    return f"Floors from above to below, and imports from each to those below it. {'. '.join(sentences)}."


class Floors(Directive):
    """The picture."""

    def run(self) -> list[nodes.Node]:
        """Read the package, and draw."""
        for path in PACKAGE.rglob("*.py"):
            self.state.document.settings.record_dependencies.add(str(path))
        drawn = house()
        picture = nodes.raw("", svg(drawn), format="html")
        return [nodes.container("", picture, classes=["scrolled", "floors"])]


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("floors", Floors)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
