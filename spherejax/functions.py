"""Functions of one number: laws of force elements, motions of drivers, roads.

    sj.RotationDriver("crank", motion=sj.functions.Linear(slope=10.0))

Constants, lines, polynomials, sines, steps, tables, sums, pieces, integrals, random roads, networks, and
`AbstractFunction` for functions of your own.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
