"""What composing costs: a run under jax.vmap, jvp, jacfwd, grad and jit, in units of the run alone.

    python benchmarks/composing.py                            # about 10 minutes
    python benchmarks/composing.py vmap derivatives calls     # these parts

Four-bar, 0.2 s, rtol 1e-8, eleven samples. All is timed in one process: a ratio is of two medians of five. `vmap` is
compared with `sj.simulate_many`, which is what `sj.sweep` runs, and with the loop over one compiled run. The unit of
derivatives is the compiled run whose number is traced, as it is under `jvp`; these are the shortest of fifteen calls
by turns.
"""

import sys
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from machine import median_seconds, shortest_by_turns, write

import spherejax as sj

TS = jnp.linspace(0.0, 0.2, 11)
RTOL = 1e-8
COARSE = 1e-6
"""A tolerance of derivatives, for who is content with it: `sensitivity_tolerance.py` has its errors."""
WIDTHS = (64, 256, 1000)

rows: list[dict[str, object]] = []


def add(case: str, what: str, seconds: float, unit: float, goal: float, compiled: float = float("nan")) -> None:
    """A row of the table."""
    rows.append(
        {
            "case": case,
            "what": what,
            "milliseconds": f"{seconds * 1e3:.2f}",
            "ratio": f"{seconds / unit:.2f}",
            "goal": "" if np.isnan(goal) else goal,
            "first_call_cpu_s": "" if np.isnan(compiled) else f"{compiled:.1f}",
        }
    )
    print(rows[-1], flush=True)


def dry(clearance, mu=0.1, restitution=0.9):
    """Dry with friction."""
    normal = sj.LankaraniNikravesh(restitution=restitution)
    return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu)))


def bushing(stiffness, damping=1e-4):
    """An elastic bushing."""
    return sj.gallery.four_bar(sj.Bushing(stiffness, damping))


def height(scene_of: Callable, ts=TS, **options) -> Callable:
    """A run's final height [m] from the numbers of its scene."""
    return lambda *numbers: sj.simulate(scene_of(*numbers), ts, rtol=RTOL, **options).position("rocker")[-1, 2]


def timed(function: Callable, *arguments) -> tuple[float, float]:
    """Median time [s] of a compiled call, and the processor time of the first [s]."""
    begin = time.process_time()
    jax.block_until_ready(function(*arguments))
    first = time.process_time() - begin
    return median_seconds(lambda: jax.block_until_ready(function(*arguments))), first


def of_vmap() -> None:
    """`jax.vmap` of runs against `simulate_many`, lane by lane."""
    one, _ = timed(jax.jit(height(dry)), 1e-4)
    add("dry with friction", "one run, compiled", one, one, 1.0)
    batch = jax.jit(jax.vmap(height(dry)))
    for width in WIDTHS:
        clearances, mus = jnp.linspace(5e-5, 2e-4, width), jnp.linspace(0.05, 0.15, width)
        numbers = {"clearance": clearances, "mu": mus}
        many, _ = timed(lambda numbers=numbers: sj.simulate_many(dry, numbers, TS, rtol=RTOL).trajectories.ys)
        mapped, first = timed(batch, clearances, mus)
        add("dry with friction", f"a lane of simulate_many, {width}", many / width, one, float("nan"))
        add(
            "dry with friction",
            f"a lane of vmap in lanes of simulate_many, {width}",
            mapped / width,
            many / width,
            1.15,
            first,
        )


def of_derivatives() -> None:
    """Derivatives in units of the value."""
    cases = {
        "dry with friction": (dry, (1e-4, 0.1, 0.9)),
        "bushing k 1e6 b 1e-4": (bushing, (1e6, 1e-4)),
    }
    for case, (scene_of, numbers) in cases.items():
        one, coarse = height(scene_of), height(scene_of, derivative_rtol=COARSE)
        all_of = height(lambda numbers, scene_of=scene_of: scene_of(*numbers))
        first_of, each = numbers[0], jnp.array(numbers)
        rows_of = {
            "value": (jax.jit(one), first_of, 1.0),
            "jvp by one": (jax.jit(lambda x, one=one: jax.jvp(one, (x,), (1.0,))), first_of, 3.0),
            f"jvp by one, derivative_rtol {COARSE:g}": (
                jax.jit(lambda x, one=coarse: jax.jvp(one, (x,), (1.0,))),
                first_of,
                3.0,
            ),
            "grad by one": (jax.jit(jax.grad(one)), first_of, 5.0),
            f"jacfwd by {len(numbers)}": (jax.jit(jax.jacfwd(all_of)), each, 5.0),
            f"grad by {len(numbers)}": (jax.jit(jax.grad(all_of)), each, 5.0),
        }
        shortest = shortest_by_turns(
            [lambda call=call, at=at: jax.block_until_ready(call(at)) for call, at, _ in rows_of.values()]
        )
        for (what, (_, _, goal)), seconds in zip(rows_of.items(), shortest, strict=True):
            add(case, what, seconds, shortest[0], goal)


def of_calls() -> None:
    """A call outside jit against the compiled run: Python around it, for runs that are over at once."""
    short = jnp.array([0.0, 1e-6])
    for case, model in {"ideal": sj.Ideal(), "dry with friction": sj.Dry(1e-4, friction=sj.Threlfall(0.1))}.items():
        scene = sj.gallery.four_bar(model)
        seconds, first = timed(lambda scene=scene: sj.simulate(scene, short, rtol=RTOL).ys)
        add(case, "simulate of a microsecond, outside jit", seconds, 1e-3, 1.0, first)
    for case, (scene_of, at) in {"dry with friction": (dry, 1e-4), "bushing k 1e6 b 1e-4": (bushing, 1e6)}.items():
        numbers = iter(at * np.linspace(1.0, 2.0, 1000))

        def of_twenty(scene_of=scene_of, numbers=numbers):
            return [sj.simulate(scene_of(float(next(numbers))), short, rtol=RTOL).ys for _ in range(20)]

        seconds, _ = timed(of_twenty)
        add(case, "the same with another number each time, and its scene", seconds / 20, 1e-3, 1.0)


def of_traced_stiffness() -> None:
    """A stiff joint whose numbers are traced, against the same with known numbers."""
    ts = jnp.array([0.0, 2.0])

    def run(scene):
        return sj.simulate(scene, ts, rtol=1e-6).position("rocker")[-1, 2]

    known, _ = timed(lambda: run(bushing(1e6, 1e-2)))
    traced, first = timed(jax.jit(lambda stiffness: run(bushing(stiffness, 1e-2))), 1e6)
    add("bushing k 1e6 b 1e-2, 2 s, rtol 1e-6", "known", known, known, 1.0)
    add("bushing k 1e6 b 1e-2, 2 s, rtol 1e-6", "traced", traced, known, 1.3, first)


PARTS = {"vmap": of_vmap, "derivatives": of_derivatives, "calls": of_calls, "stiffness": of_traced_stiffness}


def main() -> None:
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
    write("composing", "python benchmarks/composing.py", rows)


if __name__ == "__main__":
    main()
