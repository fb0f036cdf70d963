"""Parts by name that are loaded when one is asked for: their names are there at once, JAX takes a second."""

import ast
import importlib
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent.parent

SPELLINGS = {"BrownMcPhee": "brown-mcphee", "LuGre": "lugre"}
"""Names with capitals inside that begin no word."""


def kebab(name: str) -> str:
    """`"LankaraniNikravesh"` as `"lankarani-nikravesh"`."""
    return SPELLINGS.get(name) or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()


def laws_in(file: str) -> list[str]:
    """Names of the classes of a file of the package that someone can make, in its order; read as text, without JAX."""
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.bases]
    of_family = [c.name for c in classes if isinstance(c.bases[0], ast.Name) and c.bases[0].id.startswith("Abstract")]
    return [name for name in of_family if not name.startswith(("Abstract", "_"))]


def names_in(file: str) -> list[str]:
    """The public names of a file of the package: its `__all__`, read as text."""
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    assigned = {ast.unparse(node.targets[0]): node.value for node in tree.body if isinstance(node, ast.Assign)}
    return ast.literal_eval(assigned["__all__"])


class Parts(Mapping[str, Any]):
    """Classes and functions by the names that files and the command line use.

    Args:
        places: where each is, "package.module:name".
        words: what each is, in a line; "" where nothing is said.
    """

    def __init__(self, places: Mapping[str, str], words: Mapping[str, str] | None = None):
        self.places = dict(places)
        self.words = {name: (words or {}).get(name, "") for name in places}

    @classmethod
    def of_laws(cls, file: str, without: Collection[str] = (), ending: str = "") -> "Parts":
        """The laws that a file defines, by their names in kebab case.

        Args:
            file: in the package.
            without: names of those that have no word.
            ending: what the names end in and the words do not.
        """
        module = "spherejax." + file.removesuffix(".py").replace("/", ".")
        names = [name for name in laws_in(file) if name not in without]
        return cls({kebab(name.removesuffix(ending)): f"{module}:{name}" for name in names})

    def __getitem__(self, name: str) -> Any:
        module, _, own = self.places[name].partition(":")
        return getattr(importlib.import_module(module), own)

    def __contains__(self, name: object) -> bool:
        return name in self.places

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)
