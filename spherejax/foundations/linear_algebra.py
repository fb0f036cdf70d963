"""The linear algebra that mechanics uses: the compiler's, by one door.

Array code written with these solvers is recognized by the compiler, which replaces them by unrolled eliminations. All
files of mechanics import them from here, so that one file says where they come from. `mapped` is among them: what is
written for one thing, for all of a kind.
"""

from spherejax.compiler.linear_algebra import (
    REDUNDANT_PIVOT,
    SINGULAR_PIVOT,
    BlockPattern,
    block_solve,
    general_solve,
    mapped,
    rows_at,
    sums_by_index,
    symmetric_solve,
)

__all__ = [
    "REDUNDANT_PIVOT", "SINGULAR_PIVOT", "BlockPattern", "block_solve", "general_solve", "mapped", "rows_at",
    "sums_by_index", "symmetric_solve",
]  # fmt: skip
