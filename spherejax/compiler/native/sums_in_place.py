"""Arrays that a loop carries and only adds to: found in its program, so that each addition is made in place.

The derivatives by the weights of a network are thousands of numbers, to which each stage of each step adds as many. If
a call writes them somewhere, and they are then added, and the sum is copied to where the loop carries it, memory takes
longer than the arithmetic: a sixth of the gradient by 4,417 weights. An array is followed here from the begin of a
turn to its end; as long as nothing but the next sum reads it, it is an accumulator, and stays in one place:

    sum          accumulator + x, where x may come from
                     a call of a scalar program, which then adds its result itself (`FunctionText`), or
                     a scan that adds to zeros, and then begins with the accumulator instead
    branch       if in each branch it is an accumulator or is returned as it is
    loop         within a loop
    program      that is called

Sums differ by rounding from those of the program, for their terms are added in another order.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jax.extend import core as jex

from spherejax.compiler import private
from spherejax.compiler.operations import FLOAT, INNER_PROGRAM
from spherejax.compiler.primitive import is_called


class Term(NamedTuple):
    """A result that its operation adds to an accumulator.

    Attributes:
        operation: index of the operation.
        result: which of its results.
        begin: the operand in whose place the accumulator stands; None where it is a further one.
        unread: operations that need not be written then.
    """

    operation: int
    result: int
    begin: int | None
    unread: tuple[int, ...]


class Passage(NamedTuple):
    """An operation that an accumulator goes through.

    Attributes:
        operation: index of the operation.
        operand, result: where the accumulator is among its operands and results.
        term: what is added, if its operation adds it.
    """

    operation: int
    operand: int
    result: int
    term: Term | None


class SumsInPlace(NamedTuple):
    """How the operations of a program are written.

    Attributes:
        passages: operations that change accumulators, each with the operands and results that these are.
        terms: operations that add results, each with these and the names of their accumulators before and behind.
        sums: operations that are sums of two arrays, with the operand that is the accumulator.
        unread: operations that are not written.
    """

    passages: Mapping[int, Sequence[tuple[int, int]]]
    terms: Mapping[int, Sequence[tuple[Term, Any, Any]]]
    sums: Mapping[int, int]
    unread: frozenset[int]


NOTHING = SumsInPlace({}, {}, {}, frozenset())


def sums_in_place(jaxpr: Any, accumulators: Sequence[tuple[int, int]]) -> SumsInPlace:
    """How a program is written, of which some arguments are accumulators.

    Args:
        jaxpr: the program.
        accumulators: these arguments, each with the result that it becomes, as `accumulators_of` says.
    """
    if not accumulators:
        return NOTHING
    passages: dict[int, list[tuple[int, int]]] = {}
    terms: dict[int, list] = {}
    sums: dict[int, int] = {}
    unread: set[int] = set()
    program = _Program(jaxpr)
    for argument, result in accumulators:
        way = program.way(argument, result)
        assert way is not None, "an array that is no accumulator"
        for operation, operand, becomes, term in way:
            equation = jaxpr.eqns[operation]
            if term is not None:
                names = equation.invars[operand], equation.outvars[0]
                terms.setdefault(term.operation, []).append((term, *names))
                unread.update((operation, *term.unread))
            elif equation.primitive.name in SUMS:
                sums[operation] = operand
            else:
                passages.setdefault(operation, []).append((operand, becomes))
    return SumsInPlace(passages, terms, sums, frozenset(unread))


def accumulators_of(jaxpr: Any, pairs: Sequence[tuple[int, int]], are_summed: bool = False) -> list[tuple[int, int]]:
    """Arguments of a program that are only added to, and then results: those among some pairs of both.

    Args:
        jaxpr, pairs: the program, and pairs of arguments and results.
        are_summed: whether something is to be added to them.
    """
    program, taken = _Program(jaxpr), []
    for argument, result in pairs:
        # Of two that are added to each other one is the accumulator.
        is_new = all(jaxpr.outvars[result] is not jaxpr.outvars[other] for _, other in taken)
        way = program.way(argument, result) if is_new else None
        if way or (way is not None and not are_summed):
            taken.append((argument, result))
    return taken


def only_calls(jaxpr: Any, pairs: Sequence[tuple[int, int]]) -> dict[int, tuple[Any, int]]:
    """Accumulators to which one call adds, and which nothing reads: by their result, the call and its result.

    What is added to them may wait until the end of a loop.
    """
    program, calls = _Program(jaxpr), {}
    for argument, result in pairs:
        way = program.way(argument, result, any_begin=True) or []
        terms = [passage.term for passage in way]
        if len(terms) == 1 and terms[0] is not None and terms[0].begin is None:
            calls[result] = jaxpr.eqns[terms[0].operation], terms[0].result
    return calls


SUMS = ("add", "add_any")

_SAME_ENTRIES = ("reshape", "squeeze", "broadcast_in_dim", "reduce_sum", "convert_element_type")
"""Operations whose result, if it has as many entries as the operand, has the same ones in the same order."""


class _Program:
    """Who makes and who reads the arrays of a program."""

    def __init__(self, jaxpr: Any):
        self.jaxpr = jaxpr
        self.readers: dict[Any, list[tuple[int, int]]] = {}
        self.makers: dict[Any, tuple[int, int]] = {}
        self._inner: dict[int, _Program] = {}
        for i, equation in enumerate(jaxpr.eqns):
            self._reads(i, equation.invars)
            self.makers.update((out, (i, k)) for k, out in enumerate(equation.outvars))
        self._reads(len(jaxpr.eqns), jaxpr.outvars)

    def _reads(self, i: int, atoms: Sequence[Any]) -> None:
        for k, atom in enumerate(atoms):
            if isinstance(atom, jex.Var):
                self.readers.setdefault(atom, []).append((i, k))

    def way(self, argument: int, result: int, any_begin: bool = False) -> list[Passage] | None:
        """The operations that an accumulator goes through; None for what is none.

        Args:
            argument, result: of the program.
            any_begin: whether it may begin with any numbers, so that nothing may read its sums either.
        """
        now, last = self.jaxpr.invars[argument], self.jaxpr.outvars[result]
        made_by, way = -1, []
        if not isinstance(last, jex.Var) or (any_begin and len(self.readers[last]) != 1):
            return None
        while now is not last:
            readers = self.readers.get(now, ())
            # Whoever reads it beside the next sum might read it when more has been added.
            if len(readers) != 1 or readers[0][0] == len(self.jaxpr.eqns):
                return None
            passage = self._passage(*readers[0], made_by, any_begin)
            if passage is None:
                return None
            way.append(passage)
            made_by = passage.operation if passage.term is None else passage.term.operation
            now = self.jaxpr.eqns[passage.operation].outvars[passage.result]
        return way

    def _passage(self, i: int, operand: int, made_by: int, any_begin: bool) -> Passage | None:
        equation = self.jaxpr.eqns[i]
        if equation.primitive.name in SUMS:
            other = equation.invars[1 - operand]
            is_alike = other.aval.shape == equation.invars[operand].aval.shape
            return Passage(i, operand, 0, self._term(other, made_by)) if is_alike else None
        programs, argument, results = _inside(equation, operand, any_begin)
        for result in results:
            if all(self._inner_program(jaxpr).way(argument, result, any_begin) is not None for jaxpr in programs):
                return Passage(i, operand, result, None)
        return None

    def _inner_program(self, closed: Any) -> "_Program":
        jaxpr = getattr(closed, "jaxpr", closed)
        # By identity: all of them live as long as this program.
        if id(jaxpr) not in self._inner:
            self._inner[id(jaxpr)] = _Program(jaxpr)
        return self._inner[id(jaxpr)]

    def _term(self, atom: Any, made_by: int) -> Term | None:
        """The operation that can add an array to an accumulator; None where the array is added entry by entry.

        Args:
            atom: the array.
            made_by: the operation that makes the accumulator: it has to come first.
        """
        unread = []
        while True:
            if not isinstance(atom, jex.Var) or len(self.readers[atom]) != 1 or atom not in self.makers:
                return None
            i, result = self.makers[atom]
            equation = self.jaxpr.eqns[i]
            if equation.primitive.name not in _SAME_ENTRIES:
                break
            (whole, *_), out = equation.invars, equation.outvars[0]
            is_same = whole.aval.size == out.aval.size and whole.aval.dtype == out.aval.dtype
            if not is_same or (equation.primitive.name == "reshape" and equation.params["dimensions"] is not None):
                return None
            unread.append(i)
            atom = whole
        if i <= made_by:
            return None
        parameters = equation.params
        if equation.primitive.name == "straight_line":
            return Term(i, result, None, tuple(unread)) if _adds(parameters, result) else None
        if equation.primitive.name != "scan":
            return None
        n_fixed, n_carried = private.counts_of_scan(parameters)
        begin = n_fixed + result
        if result >= n_carried or self._inner_program(parameters["jaxpr"]).way(begin, result, any_begin=True) is None:
            return None
        zeros = self._zeros(equation.invars[begin])
        return None if zeros is None else Term(i, result, begin, (*unread, *zeros))

    def _zeros(self, atom: Any) -> tuple[int, ...] | None:
        """Of an array of zeros, the operation that makes it, unless more reads it; None for another array."""
        if not isinstance(atom, jex.Var) or atom not in self.makers:
            return None
        i, _ = self.makers[atom]
        equation = self.jaxpr.eqns[i]
        if equation.primitive.name != "broadcast_in_dim" or not isinstance(equation.invars[0], jex.Literal):
            return None
        if equation.invars[0].val != 0:
            return None
        return (i,) if len(self.readers[atom]) == 1 else ()


def _inside(equation: Any, operand: int, any_begin: bool) -> tuple[Sequence[Any], int, Sequence[int]]:
    """The programs inside an operation, which argument of them an operand is, and what results it may become."""
    name, parameters = equation.primitive.name, equation.params
    results = [k for k, out in enumerate(equation.outvars) if out.aval == equation.invars[operand].aval]
    if name in INNER_PROGRAM:
        return [parameters[INNER_PROGRAM[name]]], operand, results
    if name == "cond":
        return parameters["branches"], operand - 1, results if operand > 0 else ()
    if name == "scan":
        n_fixed, n_carried = private.counts_of_scan(parameters)
        at = operand - n_fixed
        return [parameters["jaxpr"]], operand, [at] if 0 <= at < n_carried else ()
    if name == "while":
        n_conditions, n_fixed = parameters["cond_nconsts"], parameters["body_nconsts"]
        condition, at = parameters["cond_jaxpr"].jaxpr, operand - n_conditions - n_fixed
        if at < 0 or (any_begin and _Program(condition).readers.get(condition.invars[n_conditions + at])):
            return (), operand, ()
        return [parameters["body_jaxpr"]], operand - n_conditions, [at]
    return (), operand, ()


def _adds(parameters: Any, result: int) -> bool:
    """Whether a call of a scalar program can add one of its results."""
    line, lanes = parameters["line"], parameters["lanes"]
    # Programs that are too small for a call, and those over lanes, write results that are added by others.
    return not lanes and is_called(line, lanes) and line.dtype(line.outputs[result]) == FLOAT
