"""Linear systems of known structure: array code, and the same as an unrolled scalar program."""

from spherejax.compiler.linear_algebra.block_pattern import BlockPattern
from spherejax.compiler.linear_algebra.blocks import block_solve
from spherejax.compiler.linear_algebra.general import general_solve
from spherejax.compiler.linear_algebra.sums import rows_at, sums_by_index
from spherejax.compiler.linear_algebra.symmetric import REDUNDANT_PIVOT, SINGULAR_PIVOT, symmetric_solve

__all__ = [
    "REDUNDANT_PIVOT", "SINGULAR_PIVOT", "BlockPattern", "block_solve", "general_solve", "rows_at", "sums_by_index",
    "symmetric_solve",
]  # fmt: skip
