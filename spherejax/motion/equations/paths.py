"""Which path a system takes: one scalar program, or array code over all bodies and joints of a kind."""

from typing import NamedTuple

from spherejax.model.system import Structure
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import LARGEST_SCALAR_PROGRAM, program_for


class Path(NamedTuple):
    """A path and the reason for it.

    Attributes:
        scalar: what `program_for` is told: None for scalar programs that are not too large, True for scalar programs,
            False for array code.
        reason: one sentence; empty for the usual path.
    """

    scalar: bool | None
    reason: str


def path_of(structure: Structure, asked: bool | None = None) -> Path:
    """The path of a system, as asked for, or array code where its right-hand side is too large a scalar program."""
    if asked is not None:
        return Path(asked, "scalar program: as asked for" if asked else "array code: as asked for")
    if not program_for(state_rate, structure).too_large:
        return Path(None, "")
    return Path(
        False,
        f"array code over bodies and joints of a kind: more than {LARGEST_SCALAR_PROGRAM} scalar operations would take "
        "long to compile (scalar=True makes the scalar program)",
    )
