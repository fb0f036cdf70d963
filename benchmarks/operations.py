"""Where the operations of a right-hand side come from, and those of its derivative: the functions that ask for them.

    python benchmarks/operations.py                     # a dry four-bar with friction, some seconds
    python benchmarks/operations.py chain n_four_bar    # any scenes of the gallery

Of each function (file and name, the innermost one of this package) the scalar operations that every evaluation makes:
of the value; of the value where its derivative is wanted, with the coefficients; of one row of the derivative along the
state. What two functions ask for counts for the first; what follows from the numbers alone is evaluated once, and does
not count.
"""

import sys
from collections import Counter
from pathlib import Path

import jax
from machine import write

import spherejax as sj
from spherejax.compiler import primitive
from spherejax.compiler import program as scalar_program
from spherejax.compiler.autodiff import Forward
from spherejax.compiler.trace import Interpreter
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for

PACKAGE = Path(sj.__file__).parent
UNDER_THE_EQUATIONS = PACKAGE / "compiler", PACKAGE / "foundations"
FREE = ("constant", "input", "custom_jvp_node")
"""Nodes that are no operations."""

STATE = 2
"""Place of the state among the arguments of a right-hand side."""


def dry() -> sj.Scene:
    """Dry with friction."""
    return sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(0.1)))


class Noting(Interpreter):
    """Notes of each node whose equation made it."""

    _asking = "another"

    def equation(self, equation, inputs):
        """As there."""
        return self._noted(equation, super().equation, equation, inputs)

    def custom_jvp_nodes(self, jaxpr, equation, inputs):
        """As there."""
        return self._noted(equation, super().custom_jvp_nodes, jaxpr, equation, inputs)

    def _noted(self, equation, make, *arguments):
        origins = vars(self.graph).setdefault("origins", {})
        begin, before = len(self.graph.operations), self._asking
        self._asking = asking_for(equation) or before
        try:
            return make(*arguments)
        finally:
            origins.update({n: origins.get(n, self._asking) for n in range(begin, len(self.graph.operations))})
            self._asking = before


def asking_for(equation) -> str:
    """The innermost function of this package that an operation of JAX was asked for by; none where it is not known."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        path = Path(frame.file_name)
        if path.is_relative_to(PACKAGE) and not any(map(path.is_relative_to, UNDER_THE_EQUATIONS)):
            return f"{path.relative_to(PACKAGE)}:{frame.function_name.rsplit('.', 1)[-1]}"
    return ""


class NotingForward(Forward):
    """Notes of each node of a derivative what the value's node has."""

    def _slope(self, node):
        values, slopes = self.values, self.slopes
        begins = [(graph, len(graph.operations)) for graph in (values, slopes)]
        found = super()._slope(node)
        origin = vars(values)["origins"].get(node, "another")
        for graph, begin in begins:
            origins = vars(graph).setdefault("origins", {})
            origins.update({n: origin for n in range(begin, len(graph.operations))})
        return found


def by_function(line) -> Counter:
    """How many operations of a line each function has asked for."""
    graph, origins = line.graph, vars(line.graph)["origins"]
    free = {*line.flat_residuals, *(n for n in line.nodes if graph.operations[n] in FREE)}
    return Counter(origins.get(n, "another") for n in line.nodes if n not in free)


def lines_of(name: str, scene: sj.Scene) -> tuple:
    """What is evaluated again and again: the value, the value with its coefficients, a row of its derivative."""
    structure, _ = flatten_system(compile_scene(scene).system)
    program = program_for(state_rate, structure).scalar
    assert program is not None, f"{name} has no scalar program"
    line = program._line("rest", True)
    derivative = line.derivative(tuple(i == STATE for i in range(len(line.shapes) + len(line.residuals))))
    return line, derivative.values, derivative.slopes


def n_evaluated(line) -> int:
    """How many operations a line evaluates."""
    operations, free = line.graph.operations, {*line.flat_residuals}
    return sum(n not in free and operations[n] not in FREE for n in line.nodes)


def rows_of(name: str, scene: sj.Scene) -> list[dict[str, object]]:
    """The rows of a scene."""
    counts = [by_function(each) for each in lines_of(name, scene)]
    functions = sorted(set().union(*counts), key=lambda each: -sum(count[each] for count in counts))
    rows: list[dict[str, object]] = [
        {"scene": name, "function": each, **dict(zip(("value", "with_coefficients", "row"), numbers, strict=True))}
        for each, *numbers in [
            ("all", *(count.total() for count in counts)),
            *((each, *(count[each] for count in counts)) for each in functions),
        ]
    ]
    return rows


def main() -> None:
    scalar_program.Interpreter = Noting
    primitive.Forward = NotingForward
    scenes = {name: getattr(sj.gallery, name) for name in sys.argv[1:]} or {"four_bar, dry with friction": dry}
    rows = [row for name, make in scenes.items() for row in rows_of(name, make())]
    for row in rows:
        print(f"{row['value']:>7} {row['with_coefficients']:>7} {row['row']:>7}  {row['function']}")
    if not sys.argv[1:]:
        write("operations", "python benchmarks/operations.py", rows)


if __name__ == "__main__":
    jax.config.update("jax_traceback_filtering", "off")
    main()
