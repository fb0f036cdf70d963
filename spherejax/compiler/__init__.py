"""A compiler for small functions: array code becomes a straight-line scalar program, and machine code of its own.

It knows nothing of mechanics, and imports nothing else of spherejax.
"""
