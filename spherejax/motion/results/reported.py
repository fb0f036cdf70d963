"""Results that can write a report of themselves."""

import os
from importlib import import_module
from pathlib import Path
from typing import Any


class Reported:
    """Gives a result the method `report`.

    Pages are made two floors up (`output.report`), which is named and not imported: nothing here depends on how a page
    looks, and no other file goes up in this way.
    """

    def report(self, path: str | os.PathLike, **options: Any) -> Path:
        """Write a page of HTML about it that opens without a network: `spherejax.report`, which explains the options.

        Args:
            path: where to write, `.html`.

        Other args:
            options: `scene`, `title`, `overwrite`.
        """
        return import_module("spherejax.output.report.reports").report(self, path, **options)
