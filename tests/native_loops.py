"""Functions whose loops become machine code, for tests of the compiler."""

import jax
from jax.extend import core as jex

from spherejax.compiler.native import loops


def in_machine_code(function, *examples):
    """The results of a function whose loop is written; none of XLA's own."""
    closed = jax.make_jaxpr(function)(*examples)

    def evaluated(*values):
        known = dict(zip([*closed.jaxpr.constvars, *closed.jaxpr.invars], [*closed.consts, *values], strict=True))

        def read(atom):
            return atom.val if isinstance(atom, jex.Literal) else known[atom]

        for equation in closed.jaxpr.eqns:
            operands = [read(atom) for atom in equation.invars]
            if equation.primitive.name == "while":
                results = loops.looped(equation.params, operands)
            else:
                results = equation.primitive.bind(*operands, **equation.params)
                results = results if equation.primitive.multiple_results else [results]
            known.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in closed.jaxpr.outvars]

    return jax.jit(evaluated)(*examples)
