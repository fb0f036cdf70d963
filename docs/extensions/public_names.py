"""Directives `public-names`: public names with their docstrings; `moved-names`: old names of the top, and the new ones.

    ```{public-names} studies.sweep motion.runs.many
    ```

are the names that these modules define, as `spherejax.NAME` where it stands at the top, and in its namespace otherwise.
A name that is added to such a module stands on the page by itself; `*` stands for any letters, and modules with a minus
are left out. Functions come first, what users build upon last.
"""

import inspect
from fnmatch import fnmatchcase
from functools import cache

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

import spherejax as sj
from spherejax.namespaces import MOVED

SPACES = [name for name in sj.__all__ if name in set(MOVED.values())]
"""Namespaces: modules that hold what does not stand at the top."""


@cache
def place_of() -> dict[str, str]:
    """The path of each public name below `spherejax`, e.g. `laws.Maxwell`; what stands at the top has no other."""
    below = {
        name: f"{space}.{name}"
        for space in SPACES
        for name in getattr(sj, space).__all__
    }
    homes = {name: f"{space}.{name}" for name, space in MOVED.items()}
    return below | homes | {name: name for name in sj.__all__}


def thing_of(path: str):
    """What a path stands for."""
    thing = sj
    for part in path.split("."):
        thing = getattr(thing, part)
    return thing


def names_of(module: str) -> list[str]:
    """Paths of names that a module, or what is below it, defines: functions, classes, and what these are built upon."""
    pattern = f"spherejax.{module}"

    def is_there(path: str) -> bool:
        thing = thing_of(path)
        place = "" if inspect.ismodule(thing) else getattr(thing, "__module__", "")
        return fnmatchcase(place, pattern) or fnmatchcase(place, f"{pattern}.*")

    def order(path: str):
        name = path.rpartition(".")[2]
        return (
            inspect.isclass(thing_of(path)),
            name.startswith("Abstract"),
            name.lower(),
        )

    found = sorted(filter(is_there, set(place_of().values())), key=order)
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
            is_class = inspect.isclass(thing_of(name))
            lines += [
                "```{eval-rst}",
                f".. auto{'class' if is_class else 'function'}:: spherejax.{name}",
            ]
            lines += ["   :members:"] * is_class + ["```", ""]
        section = nodes.section()
        self.state.nested_parse(StringList(lines), self.content_offset, section)
        return section.children


class MovedNames(Directive):
    """A table of names that moved, by namespace."""

    def run(self) -> list[nodes.Node]:
        """Write the table, and have it parsed."""
        rows = [
            f"| `sj.{space}` | {', '.join(f'`{n}`' for n in sorted(MOVED) if MOVED[n] == space)} |"
            for space in SPACES
        ]
        lines = ["| now in | names that stood in `sj.` |", "|---|---|", *rows]
        section = nodes.section()
        self.state.nested_parse(StringList(lines), self.content_offset, section)
        return section.children


def setup(app: Sphinx) -> dict:
    """Register the directives."""
    app.add_directive("public-names", PublicNames)
    app.add_directive("moved-names", MovedNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
