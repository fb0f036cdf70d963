"""Array code that the compiler recognizes: linear systems of known structure, sums, functions that are mapped."""

from spherejax.compiler.linear_algebra.block_pattern import BlockPattern
from spherejax.compiler.linear_algebra.blocks import block_solve
from spherejax.compiler.linear_algebra.general import general_solve
from spherejax.compiler.linear_algebra.mapping import mapped
from spherejax.compiler.linear_algebra.sums import rows_at, sums_by_index
from spherejax.compiler.linear_algebra.symmetric import REDUNDANT_PIVOT, SINGULAR_PIVOT, symmetric_solve

__all__ = [
    "REDUNDANT_PIVOT", "SINGULAR_PIVOT", "BlockPattern", "block_solve", "general_solve", "mapped", "rows_at",
    "sums_by_index", "symmetric_solve",
]  # fmt: skip
