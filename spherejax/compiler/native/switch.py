"""The switch for machine code, as users of the compiler see it."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native import mapped_programs as mapped_programs  # what `jax.vmap` makes of loops
from spherejax.compiler.native.loop_fusion import fuse_loops, whole_loops
from spherejax.compiler.native.uninitialized import uninitialized
from spherejax.compiler.native.whole_programs import as_one_call, leaves_loops


class native_code:  # noqa: N801 - a context manager, as those of contextlib
    """Programs that are traced in this context become machine code; or they do not, where `enabled` is False.

        with native_code():
            dy = jax.jit(program)(t, y)

    As a decorator it does more: loops in the function that call machine code become machine code as a whole, or have
    the rest of each turn in few kernels. A context cannot do that, because it does not see the loops. A function that
    is decorated is not to be differentiated: derivative rules of its parts are lost. With `joins=False` a loop that
    cannot be machine code as a whole is left as it is: derivatives have branches that XLA cannot write into kernels.
    With `is_one_call=True` the function becomes one call, with all around the loops, where that is not long.

    Without llvmlite, on a GPU, under `jax.disable_jit()` and with a version of jaxlib that is not known, the context
    changes nothing, and XLA compiles everything.
    """

    def __init__(self, enabled: bool = True, joins: bool = True, is_one_call: bool = False):
        self._enabled = enabled
        loops = fuse_loops if joins else whole_loops
        self._changed = partial(as_one_call, joins=joins) if is_one_call else loops
        # One stack for each entry: the same object may be entered again within itself.
        self._entered: list[ExitStack] = []

    def __enter__(self) -> None:
        """Begin."""
        stack = ExitStack()
        stack.enter_context(machine_code.native_code(self._enabled))
        self._entered.append(stack)

    def __exit__(self, *error: Any) -> None:
        """End, as it was before."""
        self._entered.pop().close()

    def __call__(self, function: Callable) -> Callable:
        """The same function within the context, with fused loops."""
        changed = self._changed(function)

        def made(*arguments: Any) -> Any:
            with machine_code.native_code(self._enabled):
                return changed(*arguments)

        return made

    is_available = staticmethod(machine_code.is_available)
    is_enabled = staticmethod(machine_code.native_code_enabled)
    record_ffi_targets = staticmethod(machine_code.record_ffi_targets)
    register_object_code = staticmethod(machine_code.register_object_code)
    note_ffi_targets = staticmethod(machine_code.note_ffi_targets)
    leaves_loops = staticmethod(leaves_loops)
    uninitialized = staticmethod(uninitialized)
