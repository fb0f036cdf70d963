"""Programs that do not call back into Python, so that JAX's persistent compilation cache can keep them."""

from collections.abc import Iterator
from contextlib import contextmanager

import equinox.internal as eqxi


@contextmanager
def without_host_checks() -> Iterator[None]:
    """Leave out diffrax's run-time checks of its arguments while it is traced.

    They are calls from the compiled program into Python, and JAX's persistent cache does not keep a program that has
    one: the integration, the largest program of all, would be compiled anew in each process. What they check is
    checked by `simulate` itself, where a bad value becomes an error or the lane's status.
    """
    before = eqxi.error_if
    eqxi.error_if = lambda x, pred, msg, **options: x
    try:
        yield
    finally:
        eqxi.error_if = before
