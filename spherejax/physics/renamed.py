"""Methods that have a new name: callers of the old one, and classes of users that override it, are served and told."""

import functools
import warnings
from collections.abc import Callable
from typing import Any


def take_old_name(cls: type, old: str, new: str) -> None:
    """Make a class that overrides a method by its old name override it by the new one.

    Called by `__init_subclass__` of the class that has both methods.

    Args:
        cls: the class that is being defined.
        old: the old name.
        new: the new name.
    """
    method = cls.__dict__.get(old)
    if method is None or new in cls.__dict__:
        return
    # The class statement of the user is behind `__init_subclass__` and three metaclasses (abc and two of Equinox).
    warnings.warn(f"{cls.__name__}.{old} is now called {new}; rename the method", DeprecationWarning, stacklevel=6)

    @functools.wraps(method)
    def renamed(self, *arguments):
        return method(self, *arguments)

    renamed._stands_for_old_name = True  # pyright: ignore[reportAttributeAccessIssue]
    setattr(cls, new, renamed)


def by_new_name(made: Any, old: str, new: str) -> Callable:
    """The method that an object has by its new name, for a call by the old one, which is warned of.

    A class that overrides the old name and calls `super()` reaches this: its own override is passed over.
    """
    warnings.warn(f"{type(made).__name__}.{old} is now called {new}", DeprecationWarning, stacklevel=3)
    for cls in type(made).__mro__:
        method = cls.__dict__.get(new)
        if method is not None and not _stands_for_old_name(method):
            return method.__get__(made, type(made))
    raise AttributeError(f"{type(made).__name__} has no {new}")


def _stands_for_old_name(method: Any) -> bool:
    """Equinox wraps the methods of its modules."""
    inner = getattr(method, "method", method)
    return getattr(inner, "_stands_for_old_name", False)
