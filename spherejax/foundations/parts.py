"""Parts by name that are loaded when one is asked for: their names are there at once, JAX takes a second."""

import importlib
from collections.abc import Iterator, Mapping
from typing import Any


class Parts(Mapping[str, Any]):
    """Classes and functions by the names that files and the command line use.

    Args:
        places: where each is, "package.module:name".
        words: what each is, in a line; "" where nothing is said.
    """

    def __init__(self, places: Mapping[str, str], words: Mapping[str, str] | None = None):
        self.places = dict(places)
        self.words = {name: (words or {}).get(name, "") for name in places}

    def __getitem__(self, name: str) -> Any:
        module, _, own = self.places[name].partition(":")
        return getattr(importlib.import_module(module), own)

    def __contains__(self, name: object) -> bool:
        return name in self.places

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)
