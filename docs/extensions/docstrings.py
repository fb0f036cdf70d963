"""Docstrings for Sphinx.

Docstrings of spherejax are plain text that a terminal shows well: Google's sections, formulas as indented lines, code
between single backticks, `|e|` and `x**2` unescaped. Here they become reStructuredText. A name between backticks that
is public becomes a link.
"""

import inspect
import re
from collections.abc import Iterator

from public_names import SPACES, place_of, thing_of
from sphinx.application import Sphinx

TITLES = ("Args:", "Other args:", "Attributes:", "Returns:", "Raises:")
ENTRY = re.compile(r"^(\*{0,2}[\w, ]+): (.*)$")
CODE = re.compile(r"`([^`]+)`")
SPECIAL = re.compile(r"([\\*|_])")


def text(line: str) -> str:
    """A line of prose, with code marked and everything else escaped."""
    parts = CODE.split(line)
    return "".join(
        code(part) if i % 2 else SPECIAL.sub(r"\\\1", part)
        for i, part in enumerate(parts)
    )


def code(content: str) -> str:
    """Code, or a link where it is a public name."""
    name = content.removeprefix("spherejax.").removeprefix("sj.").removesuffix("()")
    parts = name.split(".")
    if parts[0] in SPACES and len(parts) > 1:
        parts = parts[1:]
    path = place_of().get(parts[0], "")
    # Escaped spaces let plurals and brackets stand beside.
    thing = thing_of(path) if path else None
    is_there = path and (len(parts) == 1 or hasattr(thing, parts[1]))
    if is_there and not inspect.ismodule(thing):
        target = ".".join(["spherejax", path, *parts[1:]])
        return rf"\ :py:obj:`{content} <{target}>`\ "
    return rf"\ ``{content}``\ "


def rst(lines: list[str]) -> list[str]:
    """A docstring in reStructuredText."""
    written: list[str] = []
    for title, block in sections(lines):
        if title == "Returns:":
            written += [
                ":returns: "
                + " ".join(text(line.strip()) for line in block if line.strip()),
                "",
            ]
        elif title:
            written += entries(title, block)
        else:
            written += prose(block)
    return written


def sections(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Titles with their lines, less the indentation; prose has no title."""
    title, block = "", []
    for line in lines:
        if line in TITLES:
            yield title, block
            title, block = line, []
        elif title and line and not line.startswith(" "):
            yield title, block
            title, block = "", [line]
        else:
            block.append(line[4:] if title else line)
    yield title, block


def entries(title: str, block: list[str]) -> list[str]:
    """Named entries, `name: text` each, continued on deeper lines, as one field."""
    found: list[tuple[str, list[str]]] = []
    for line in block:
        entry = ENTRY.match(line)
        if entry:
            found.append((entry[1], [entry[2]]))
        elif line.strip() and found:
            found[-1][1].append(line.strip())
    written = [f":{title}", ""]
    for name, content in found:
        said = " ".join(text(line) for line in content)
        written.append(f"    * {named(title, name)} -- {said}")
    return [*written, ""]


def named(title: str, names: str) -> str:
    """What an entry stands for: names of values, or of an exception."""
    if title == "Raises:":
        return code(names)
    return ", ".join(f"``{name}``" for name in names.split(", "))


def prose(block: list[str]) -> list[str]:
    """Paragraphs; indented ones are formulas."""
    written: list[str] = []
    for paragraph in paragraphs(block):
        if paragraph[0].startswith("    "):
            written += [
                ".. code-block:: none",
                "",
                *("    " + line for line in paragraph),
                "",
            ]
        elif paragraph[0].startswith("* "):
            written += [
                ("* " if line.startswith("* ") else "  ") + text(line[2:])
                for line in paragraph
            ] + [""]
        else:
            said = [text(line) for line in paragraph]
            said[0] = re.sub(r"^(Limits|Source|Sources|Defaults):", r"**\1.**", said[0])
            written += [*said, ""]
    return written


def paragraphs(block: list[str]) -> Iterator[list[str]]:
    """Lines between blank lines; formulas that follow each other stay apart from what surrounds them."""
    current: list[str] = []
    for line in [*block, ""]:
        if line.strip():
            current.append(line)
        elif current:
            yield current
            current = []


def process(
    app: Sphinx, what: str, name: str, thing, options, lines: list[str]
) -> None:
    """Rewrite a docstring in place."""
    lines[:] = rst(lines)


def setup(app: Sphinx) -> dict:
    """Register the translation."""
    app.connect("autodoc-process-docstring", process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
