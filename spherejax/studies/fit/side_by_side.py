"""Many sets of unknowns at the same time: on the cores of this machine, or as lanes of an accelerator.

Runs of an integration that are mapped by `jax.vmap` go in step: each waits for the stiffest of them, and pays for its
steps. Sixteen starts of the four-bar with a bushing cost sixteen times as much so as one after the other. On cores,
lanes are therefore runs of one compiled program in threads; XLA leaves Python's lock while it computes.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

Result = TypeVar("Result")


def in_threads(function: Callable[[np.ndarray], Result], us: Sequence[np.ndarray]) -> list[Result]:
    """`function` of each, the first alone, for it may compile; an interrupt waits for what is being computed."""
    first = [function(u) for u in us[:1]]
    if len(us) < 2:
        return first
    executor = ThreadPoolExecutor(min(len(us) - 1, os.cpu_count() or 1))
    try:
        return first + list(executor.map(function, us[1:]))
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def on_accelerator() -> bool:
    """Whether computations go to a device that is fast with many lanes alone."""
    return jax.default_backend() != "cpu"


def padded(us: Sequence[np.ndarray]) -> np.ndarray:
    """With the last repeated up to a power of two, so that few sizes are compiled."""
    n = 1 << (len(us) - 1).bit_length()
    return np.concatenate([us, np.tile(us[-1], (n - len(us), 1))])
