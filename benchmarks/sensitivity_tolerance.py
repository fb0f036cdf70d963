"""What it costs to judge the errors of sensitivities, and what it costs not to: steps, time, and errors of gradients.

    python benchmarks/sensitivity_tolerance.py     # about ten minutes, most of it compiling

Four-bar, 0.2 s, rtol 1e-8, under `derivative_rtol`, which the first column has in units of rtol; "ours" is what
`sj.simulate` takes without. The rocker's last position by all numbers together, each scaled by its number, against the
same at an rtol of 1e-12 (the film: 1e-11). The time is of `jax.jvp` by the first number, in units of the run alone: the
shortest of fifteen by turns.
"""

import sys

import jax
import jax.numpy as jnp
from machine import shortest_by_turns, use_one_core, write

use_one_core()

import spherejax as sj  # noqa: E402

TS = jnp.linspace(0.0, 0.2, 3)
RTOL = 1e-8


def dry(clearance, mu, restitution):
    """Dry with friction: thirty onsets."""
    normal = sj.LankaraniNikravesh(restitution)
    return sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu=mu, v1=1e-3))


def film(viscosity, clearance):
    """Lubricated, full film."""
    return sj.Lubricated(clearance, viscosity=viscosity)


CASES = {
    "dry with friction": (dry, (1e-4, 0.1, 0.9), 1e-12, 2.0, (0.2, 20.0, 100.0, 1000.0, jnp.inf)),
    "bushing k 1e6 b 1e-4": (sj.Bushing, (1e6, 1e-4), 1e-12, 2.0, (0.2, 20.0, 100.0, 1000.0, jnp.inf)),
    "lubricated": (film, (0.4, 1e-4), 1e-11, 1000.0, (2.0, 20.0, 100.0, jnp.inf)),
}
"""Of each: the joint, its numbers, the tolerance of the reference, our factor, and others."""


def rows_of(case: str) -> list[dict[str, object]]:
    """The rows of a case."""
    model, numbers, fine, ours, others = CASES[case]
    numbers = jnp.array(numbers)

    def end(numbers, rtol, factor):
        scene = sj.gallery.four_bar(model(*numbers))
        run = sj.simulate(scene, TS, rtol=rtol, derivative_rtol=factor * rtol)
        return run.position("rocker")[-1], run.stats.n_steps

    def along(numbers, rtol, factor, direction):
        return jax.jvp(lambda numbers: end(numbers, rtol, factor), (numbers,), (direction,))

    directions = jnp.diag(numbers)
    all_of = jax.jit(jax.vmap(along, (None, None, None, 0)))
    # The others known: a number that is traced has a row of its own, whatever the direction.
    rest = tuple(map(float, numbers[1:]))

    def end_of(first, rtol, factor):
        return end((first, *rest), rtol, factor)

    by_first = jax.jit(
        lambda first, rtol, factor: jax.jvp(lambda first: end_of(first, rtol, factor), (first,), (numbers[0],))
    )
    plain = jax.jit(lambda first: end_of(first, RTOL, 1.0))
    plain_steps = int(plain(numbers[0])[1])
    reference = all_of(numbers, fine, min(ours, 1.0), directions)[1][0]
    rows: list[dict[str, object]] = []
    for factor in sorted((ours, *others)):
        (_, n_steps), (found, _) = all_of(numbers, RTOL, factor, directions)
        error = jnp.max(jnp.abs(found - reference), 1) / jnp.max(jnp.abs(reference), 1)
        unit, seconds = shortest_by_turns(
            [
                lambda: jax.block_until_ready(plain(numbers[0])),
                lambda factor=factor: jax.block_until_ready(by_first(numbers[0], RTOL, factor)),
            ]
        )
        rows.append(
            {
                "case": case,
                "factor": f"{factor:g}" + (" (ours)" if factor == ours else ""),
                "steps": int(n_steps[0]),
                "steps_of_plain": f"{int(n_steps[0]) / plain_steps:.2f}",
                "jvp_by_one_of_plain": f"{seconds / unit:.2f}",
                "errors": " ".join(f"{float(each):.1e}" for each in error),
            }
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Print the table and write it."""
    rows = [row for case in sys.argv[1:] or CASES for row in rows_of(case)]
    if not sys.argv[1:]:
        write("sensitivity_tolerance", "python benchmarks/sensitivity_tolerance.py", rows)


if __name__ == "__main__":
    main()
