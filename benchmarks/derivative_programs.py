"""Programs of runs and of their derivatives: how large they are, and what they cost to trace, to compile and to run.

    python benchmarks/derivative_programs.py          # about a minute
    python benchmarks/derivative_programs.py film     # this case too: some minutes

Four-bar, 0.2 s, rtol 1e-8, by one number. The time of a run is the shortest of fifteen, for what else the machine does
only adds to it. `instructions` are those of the fused loops of the compiled module; `written` is how many of them the
compiler's emitter writes, counted on the module's text: within a loop an instruction is written once for every place at
which it is read, and every change of shape, slice and operand of a concatenation makes new places. Where `written` is
many times `instructions`, something is evaluated again and again.
"""

import os
import re
import sys
import time

os.environ["SPHEREJAX_CACHE"] = "0"  # what is kept on disk compiles at once

import jax
import jax.numpy as jnp
from machine import median_seconds, write

import spherejax as sj

TS = jnp.linspace(0.0, 0.2, 11)
RTOL = 1e-8
MOST = 1_000_000
"""Written instructions of one loop at which counting ends."""


def dry(clearance):
    """Dry with friction."""
    normal = sj.LankaraniNikravesh(restitution=0.9)
    return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(0.1)))


CASES = {
    "dry": (dry, 1e-4),
    "bushing": (lambda stiffness: sj.gallery.four_bar(sj.Bushing(stiffness, 1e-4)), 1e6),
    "film": (lambda viscosity: sj.gallery.four_bar(sj.Lubricated(1e-4, viscosity=viscosity)), 0.4),
}


def computations(module: str) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Instructions of the computations in a module's text: operation and operands by name, the last one the root."""
    found: dict[str, dict[str, tuple[str, list[str]]]] = {}
    inside = None
    for line in module.splitlines():
        head = re.match(r"^(?:ENTRY )?%?([\w.\-]+) \(", line)
        if head and line.rstrip().endswith("{"):
            inside = found.setdefault(head[1], {})
        elif line.startswith("}"):
            inside = None
        elif inside is not None:
            one = re.match(r"\s+(?:ROOT )?%([\w.\-]+) = (?:\(.*?\)|\S+) ([a-z\-]+)\((.*?)\)(?:,|$)", line)
            if one:
                inside[one[1]] = one[2], re.findall(r"%([\w.\-]+)", one[3])
    return found


def written(instructions: dict[str, tuple[str, list[str]]]) -> int:
    """How many instructions are written for a fused loop whose root is the last one; at most `MOST`."""
    count, places = 0, 0
    seen: set[tuple[str, int]] = set()
    open_: list[tuple[str, int]] = [(next(reversed(instructions)), 0)]
    while open_ and count < MOST:
        name, place = open_.pop()
        if (name, place) in seen or name not in instructions:
            continue
        seen.add((name, place))
        count += 1
        operation, operands = instructions[name]
        for operand in operands:
            if operation in ("bitcast", "reshape", "slice", "concatenate"):
                places += 1
                open_.append((operand, places))
            else:
                open_.append((operand, place))
    return count


def row(case: str, what: str) -> dict[str, object]:
    """One program, made and run."""
    build, number = CASES[case]

    def height(x):
        return sj.simulate(build(x), TS, rtol=RTOL).position("rocker")[-1, 2]

    functions = {"value": height, "jvp": lambda x: jax.jvp(height, (x,), (jnp.ones(()),)), "grad": jax.grad(height)}
    begin = time.process_time()
    lowered = jax.jit(functions[what]).lower(jnp.asarray(number))
    traced = time.process_time()
    compiled = lowered.compile()
    done = time.process_time()
    x = jnp.asarray(number)
    seconds = min(median_seconds(lambda: jax.block_until_ready(compiled(x)), 1) for _ in range(15))
    fused = [each for name, each in computations(compiled.as_text()).items() if name.startswith(("fused", "wrapped"))]
    counts = [written(each) for each in fused if each]
    found = {
        "case": case,
        "program": what,
        "trace_cpu_s": f"{traced - begin:.1f}",
        "compile_cpu_s": f"{done - traced:.1f}",
        "run_ms": f"{1e3 * seconds:.2f}",
        "instructions": sum(map(len, fused)),
        "written": sum(counts),
        "written_of_the_largest": max(counts),
    }
    print(found, flush=True)
    return found


def main() -> None:
    """Make, count and time the programs."""
    cases = ("dry", "bushing", *sys.argv[1:])
    rows = [row(case, what) for case in cases for what in ("value", "jvp", "grad")]
    write("derivative_programs", " ".join(["python benchmarks/derivative_programs.py", *sys.argv[1:]]), rows)


if __name__ == "__main__":
    main()
