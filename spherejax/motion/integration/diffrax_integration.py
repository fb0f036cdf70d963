"""diffrax's integration as a program that does not call back into Python.

diffrax checks sample times while the compiled program runs, by calls from it into Python. JAX's persistent compilation
cache does not keep a program that makes such calls: the integration, the largest program of all, would be compiled anew
in each process. What diffrax checks is checked by `simulate` itself, where a bad value becomes an error or the lane's
status.
"""

import inspect
from types import FunctionType
from typing import Any

import diffrax
import equinox.internal as eqxi


class _WithoutHostChecks:
    """`equinox.internal` with an `error_if` that checks nothing."""

    def __getattr__(self, name: str) -> Any:
        return getattr(eqxi, name)

    @staticmethod
    def error_if(x, pred, msg: str, **options):
        """Its first argument, as it is."""
        del pred, msg, options
        return x


def _without_host_checks(function: Any) -> Any:
    """A function of another module with a global scope of its own, in which nothing is checked.

    The module itself stays as it is: other calls, those of other threads among them, keep all their checks.
    """
    function = inspect.unwrap(function)
    scope = {**function.__globals__, "eqxi": _WithoutHostChecks()}
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


diffeqsolve = _without_host_checks(diffrax.diffeqsolve)
"""`diffrax.diffeqsolve` without its checks of sample times, to be called while a program is traced."""
