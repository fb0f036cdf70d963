"""Whether somebody watches, and where to show them how far a study is."""

import sys


def is_watched() -> bool:
    """Whether standard error is a terminal, or this is a notebook."""
    return sys.stderr.isatty() or is_notebook()


def is_notebook() -> bool:
    """Whether this runs in a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"


def console():
    """rich's console on standard error, or in the notebook."""
    from rich.console import Console

    return Console(stderr=not is_notebook())
