"""Directive `public-names`: the public names of spherejax that some of its modules define, with their docstrings.

    ```{public-names} studies.sweep motion.runs.many
    ```

A name that is added to such a module stands on the page by itself. Functions come first.
"""

import inspect

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

import spherejax as sj


def names_of(module: str) -> list[str]:
    """Public names that a module, or what is below it, defines; functions first."""
    place = f"spherejax.{module}"
    found = [
        name
        for name in sj.__all__
        if f"{getattr(getattr(sj, name), '__module__', '')}.".startswith(f"{place}.")
    ]
    if not found:
        raise SphinxError(f"no public name is defined in {place}")
    return sorted(
        found, key=lambda name: (inspect.isclass(getattr(sj, name)), name.lower())
    )


class PublicNames(Directive):
    """Each name as autodoc shows it."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Write the page, and have it parsed."""
        lines: list[str] = []
        for name in [
            name for module in self.arguments[0].split() for name in names_of(module)
        ]:
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
