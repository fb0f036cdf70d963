"""Directive `public-names`: the public names of spherejax that some of its modules define, with their docstrings.

    ```{public-names} studies.sweep motion.runs.many
    ```

A name that is added to such a module stands on the page by itself; `*` stands for any letters, and modules with a minus
are left out. Functions come first, what users build upon last.
"""

import inspect
from fnmatch import fnmatchcase

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

import spherejax as sj


def names_of(module: str) -> list[str]:
    """Public names that a module, or what is below it, defines: functions, classes, and what these are built upon."""
    pattern = f"spherejax.{module}"

    def is_there(name: str) -> bool:
        place = getattr(getattr(sj, name), "__module__", "")
        return fnmatchcase(place, pattern) or fnmatchcase(place, f"{pattern}.*")

    def order(name: str):
        is_class = inspect.isclass(getattr(sj, name))
        return is_class, name.startswith("Abstract"), name.lower()

    found = sorted(filter(is_there, sj.__all__), key=order)
    if not found:
        raise SphinxError(f"no public name is defined in {pattern}")
    return found


def names_asked_for(words: list[str]) -> list[str]:
    """Names of all modules of a list, without those of modules with a minus before them."""
    left_out = {name for word in words if word[0] == "-" for name in names_of(word[1:])}
    found = [name for word in words if word[0] != "-" for name in names_of(word)]
    return [name for name in found if name not in left_out]


class PublicNames(Directive):
    """Each name as autodoc shows it."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Write the page, and have it parsed."""
        lines: list[str] = []
        for name in names_asked_for(self.arguments[0].split()):
            is_class = inspect.isclass(getattr(sj, name))
            lines += [
                "```{eval-rst}",
                f".. auto{'class' if is_class else 'function'}:: spherejax.{name}",
            ]
            lines += ["   :members:"] * is_class + ["```", ""]
        section = nodes.section()
        self.state.nested_parse(StringList(lines), self.content_offset, section)
        return section.children


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
