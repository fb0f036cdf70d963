"""Where random numbers come from: the argument `rng`, as SPEC 7 of Scientific Python has it, and its earlier name."""

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from spherejax.foundations.errors import SceneError

Rng = int | np.random.Generator | np.random.SeedSequence | np.random.BitGenerator | None
"""A whole number that gives the same random numbers each time, a generator of NumPy, or None for others each time."""

F = TypeVar("F", bound=Callable[..., Any])


def generator(rng: Rng) -> np.random.Generator:
    """The generator that an argument `rng` means.

    Raises:
        SceneError: for a value that means none.
    """
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError) as error:
        raise SceneError(f"rng = {rng!r} must be a whole number, a numpy.random.Generator or None ({error})") from None


def rng_was_seed(function: F) -> F:
    """The function, which takes its argument `rng` by the earlier name `seed` too, with a DeprecationWarning.

    Raises:
        TypeError: in a call that gives both.
    """

    @functools.wraps(function)
    def renamed(*arguments: Any, **named: Any) -> Any:
        if "seed" in named:
            if "rng" in named:
                raise TypeError("rng= is the new name of seed=; give one of both")
            said = "seed= is called rng= (SPEC 7); the earlier name goes away in the next version"
            warnings.warn(said, DeprecationWarning, stacklevel=2)
            named["rng"] = named.pop("seed")
        return function(*arguments, **named)

    return cast(F, renamed)
