"""What lies around the loops of a run, and these loops, as one call of machine code.

A run of a few steps takes a twentieth of a millisecond. XLA compiles what lies around its loops (the numbers of
the run, its tolerances, what is counted at its end) into a hundred kernels, calls each by itself, and hands a program
with more than a thousand operations to a thread of its own, for which the caller waits: more than the run takes. Here
all of it becomes one function, which is for XLA a program without operations.

What has no rule is left to XLA, around the loops.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core as jex
from jax.interpreters.partial_eval import dce_jaxpr

from spherejax.compiler.emit.llvm_arena import SMALLEST_SHARED
from spherejax.compiler.emit.llvm_arrays import (
    ArrayText,
    InPlace,
    Memory,
    NotWrittenError,
    Value,
    within_limits,
)
from spherejax.compiler.native.loop_fusion import changed, fuse_loops, whole_loops
from spherejax.compiler.native.loops import LOOP, LoopText, WrittenLoop, bound, is_index
from spherejax.compiler.native.uninitialized import UNINITIALIZED

LARGEST_WHOLE = 30_000
"""Lines of such a function, at most. LLVM takes 60 us for each: more than is gained is soon lost."""


def as_one_call(function: Callable, joins: bool) -> Callable:
    """The same function as one call of machine code, where all in it has a rule; else `fuse_loops` where it joins, and
    `whole_loops` where not.

    Not to be differentiated, see `changed`.
    """
    return changed((fuse_loops if joins else whole_loops)(function), _in_one_call)


def _in_one_call(closed: Any, values: Sequence) -> Sequence:
    jaxpr, _ = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    try:
        return _called(jaxpr, closed.consts, values)
    except NotWrittenError as reason:
        logging.getLogger(__name__).info("what is around the loops of a run is left to XLA: %s", reason)
        return jex.jaxpr_as_fun(jex.ClosedJaxpr(jaxpr, closed.consts))(*values)


def leaves_loops(jaxpr: Any) -> bool:
    """Whether a program has loops that are left to XLA, which may end after any number of turns, or has no others."""
    names = [*_names(jaxpr)]
    return LOOP not in names or "while" in names


def _names(jaxpr: Any) -> Iterator[str]:
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        for inner in jex.jaxprs_in_params(equation.params):
            yield from _names(inner)


class _Aliases(NamedTuple):
    """Large arrays that loops change, and where they are.

    Attributes:
        own: indices of arguments that are changed, each with the result that it becomes.
        results: of the function; behind those that are asked for stand other arrays that are changed.
    """

    own: Mapping[int, int]
    results: Sequence[Any]


def _called(jaxpr: Any, constants: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    """The results of a program, by one call.

    Raises:
        NotWrittenError: if something in it has no rule.
    """
    rooms = [equation for equation in jaxpr.eqns if equation.primitive.name == UNINITIALIZED]
    equations = [equation for equation in jaxpr.eqns if equation.primitive.name != UNINITIALIZED]
    if not any(equation.primitive.name == LOOP for equation in equations):
        raise NotWrittenError("no loop in machine code")
    # Indices are written into the text, where they say which entries are moved. Other constants are passed, so that
    # the text is the same for other numbers.
    known = {v: np.asarray(x) for v, x in zip(jaxpr.constvars, constants, strict=True) if is_index(x)}
    given = [(v, x) for v, x in zip(jaxpr.constvars, constants, strict=True) if v not in known]
    room = [out for equation in rooms for out in equation.outvars]
    invars = [*(v for v, _ in given), *jaxpr.invars, *room]
    arrays = [*(x for _, x in given), *values]
    # Room is asked for by calls of its own: to XLA it is an array as any other, which it may give away.
    arrays += [equation.primitive.bind(**equation.params) for equation in rooms]
    arrays = [jax.numpy.asarray(x, v.aval.dtype) for v, x in zip(invars, arrays, strict=True)]

    def written(limits: InPlace) -> tuple[WrittenLoop, Sequence[Any]]:
        aliases = _aliases_of(equations, invars, jaxpr.outvars)
        text = WholeText(invars, equations, aliases, known, limits).whole()
        first = len(invars) - len(room)
        unread = tuple(a for a, r in aliases.own.items() if a >= first and r >= len(jaxpr.outvars))
        return text._replace(rooms=unread), [v.aval for v in aliases.results]

    return bound(arrays, *within_limits(written))[: len(jaxpr.outvars)]


def _aliases_of(equations: Sequence[Any], invars: Sequence[Any], outvars: Sequence[Any]) -> _Aliases:
    """Which arguments are changed in place by the loops that are called, and which results they become."""
    origin = {v: i for i, v in enumerate(invars)}
    latest: dict[int, Any] = {}
    for equation in equations:
        for target, result in _handed_on(equation):
            if isinstance(target, jex.Var) and target in origin:
                origin[result] = origin[target]
                if origin[target] in latest:
                    latest[origin[target]] = result
        if equation.primitive.name != LOOP:
            continue
        for argument, result in equation.params["written"].in_place:
            atom = equation.invars[argument]
            if isinstance(atom, jex.Var) and atom in origin:
                origin[equation.outvars[result]] = origin[atom]
                latest[origin[atom]] = equation.outvars[result]
    results = [*outvars]
    own = {}
    for argument, last in latest.items():
        if last not in results:
            results.append(last)
        own[argument] = results.index(last)
    return _Aliases(own, results)


def _handed_on(equation: Any) -> Iterable[tuple[Any, Any]]:
    """Arguments of an operation other than a loop that is called, each with the result that stands in its place."""
    if equation.primitive.name == "dynamic_update_slice":
        return [(equation.invars[0], equation.outvars[0])]
    if equation.primitive.name == "while":
        n_fixed = equation.params["cond_nconsts"] + equation.params["body_nconsts"]
        return zip(equation.invars[n_fixed:], equation.outvars, strict=True)
    return []


class WholeText(LoopText):
    """The text of a program with the loops that it calls.

    Args:
        invars, equations: of the program.
        aliases: of arrays that loops change in place.
        known: constants that are written into the text.
        limits: as of `LoopText`.
    """

    def __init__(
        self,
        invars: Sequence[Any],
        equations: Sequence[Any],
        aliases: _Aliases,
        known: Mapping[Any, Any],
        limits: InPlace,
    ):
        super().__init__(None, [v.aval for v in invars], [v.aval for v in aliases.results], limits, known)
        self.text = ArrayText(smallest_shared=SMALLEST_SHARED, large=limits.large)
        self._invars, self._equations, self._aliases = invars, equations, aliases

    def written(self) -> str:
        """The text of a function that XLA calls."""
        text, own = self.text, self._aliases.own
        environment: dict[Any, Value] = {v: self.constant(x) for v, x in self._known.items()}
        for i, v in enumerate(self._invars):
            value = self._given(v.aval, f"%a{i}")
            if i in own:
                self.in_place.append((i, own[i]))
                slot = Value(v.aval.shape, value.kind, f"%r{own[i]}", Memory(is_own=True, room=value.size))
                self._copy_elsewhere(value, slot)
                value = slot
            environment[v] = value
        results = self.evaluated(self._equations, self._aliases.results, environment)
        for i, (value, aval) in enumerate(zip(results, self.results, strict=True)):
            self._result(text.checked(value), aval, f"%r{i}")
        return self._with_room()

    def equation(self, equation: Any, values: list[Value]) -> list[Value]:
        """The results of an operation."""
        if len(self.text.lines) > LARGEST_WHOLE:
            raise NotWrittenError("a long program")
        return super().equation(equation, values)
