"""The automatic choice of method against every method by hand: is it ever more than twice as slow as the best?

    python benchmarks/automatic_choice.py

Four-bar, 0.2 s. The methods are those of `METHODS`. Times are those of a compiled call on one core; the ratio is that
of a method's time to the fastest of those that reach the end; a row is the choice where the numbers are traced. The
error is the largest of the rocker's height at 5 samples against a run of the same equations at rtol 1e-11. Methods err
differently at one tolerance, so of a choice there is also the ratio to the fastest of all runs, whatever their method
and tolerance, that err no more.
"""

from machine import median_seconds, use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.model.system import compile_scene  # noqa: E402
from spherejax.motion.solvers.automatic import choose_solver  # noqa: E402

METHODS = {
    "Dopri8": diffrax.Dopri8(),
    "Tsit5": diffrax.Tsit5(),
    "Rodas5P": sj.solvers.Rodas5P(),
    "Ros34PW2": sj.solvers.Ros34PW2(),
    "Kvaerno3": diffrax.Kvaerno3(),
}
RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
TRACED = "chosen of traced numbers"
"""The row of the choice that is made where `jax.jit` hides the numbers, as it does here."""
TS = jnp.linspace(0.0, 0.2, 5)
MAX_STEPS = 200_000

FAMILIES = {
    "bushing k={} b={}": (
        lambda k, b: sj.Bushing(k, b),
        [(1e5, 1e-3), (1e6, 1e-4), (1e6, 1e-3), (1e6, 1e-2), (1e6, 1e-1), (1e8, 1e-4), (1e8, 1e-2)],
    ),
    "film c={} viscosity={}": (
        lambda c, viscosity: sj.Lubricated(c, viscosity=viscosity),
        [(1e-4, 0.4), (1e-4, 0.04), (1e-4, 4.0), (5e-5, 0.4), (2e-4, 0.4)],
    ),
    "paper's film c={} viscosity={}": (
        lambda c, viscosity: sj.Lubricated(c, viscosity=viscosity, film=sj.laws.RadialFilm()),
        [(1e-4, 0.4), (1e-4, 0.04), (1e-4, 4.0), (5e-5, 0.4), (2e-4, 0.4)],
    ),
    "friction c={} mu={}": (
        lambda c, mu: sj.Dry(c, friction=sj.Threlfall(mu=mu)),
        [(1e-4, 0.1), (2e-5, 0.1), (5e-4, 0.3)],
    ),
    "ideal": (lambda: sj.Ideal(), [()]),
}


def programs(build):
    """For each method a compiled function from the model's numbers and the tolerance to heights, steps and status."""

    def program(method):
        @jax.jit
        def run(numbers, rtol):
            scene = sj.gallery.four_bar(build(*numbers))
            motion = sj.simulate(scene, TS, rtol=rtol, atol=1e-2 * rtol, solver=method, max_steps=MAX_STEPS)
            return motion.position("rocker")[:, 2], motion.stats.n_steps, motion.status

        return run

    return {name: program(method) for name, method in {**METHODS, TRACED: None}.items()}


def reference_of(runs, numbers):
    """The heights of the first tight run that reaches its end."""
    for run in runs.values():
        heights, _, status = run(numbers, 1e-11)
        if int(status) == 0:
            return np.asarray(heights)
    raise RuntimeError(f"no tight run of {numbers} reaches its end")


def rows_of(label, build, numbers, runs):
    reference = reference_of(runs, numbers)
    system = compile_scene(sj.gallery.four_bar(build(*numbers))).system
    all_rows = []
    for rtol in RTOLS:
        choice = type(choose_solver(system, rtol).solver).__name__
        seconds, rows = {}, []
        for name, run in runs.items():
            heights, n_steps, status = run(numbers, rtol)
            if int(status) == 0:
                seconds[name] = median_seconds(lambda run=run: jax.block_until_ready(run(numbers, rtol)))  # noqa: B023
            error = float(np.max(np.abs(np.asarray(heights) - reference)))
            rows.append(
                {
                    "case": label,
                    "rtol": f"{rtol:.0e}",
                    "method": name,
                    "milliseconds": f"{seconds[name] * 1e3:.2f}" if name in seconds else "",
                    "steps": int(n_steps),
                    "error_m": f"{error:.1e}" if name in seconds else "",
                    "chosen": "yes" if name == choice else "",
                    "ratio_to_best": "",
                    "ratio_at_its_error": "",
                }
            )
        best = min(taken for name, taken in seconds.items() if name != TRACED)
        for row in rows:
            if row["method"] in seconds:
                row["ratio_to_best"] = f"{seconds[row['method']] / best:.2f}"
        all_rows += rows
    add_ratios_at_errors(all_rows)
    for row in all_rows:
        print(row, flush=True)
    return all_rows


def add_ratios_at_errors(rows) -> None:
    """Of each run of a case its time over that of the fastest run, of any method and tolerance, that errs no more."""
    made = [
        (float(row["error_m"]), float(row["milliseconds"]))
        for row in rows
        if row["milliseconds"] and row["method"] != TRACED
    ]
    for row in rows:
        if row["milliseconds"]:
            error, own = float(row["error_m"]), float(row["milliseconds"])
            best = min([taken for reached, taken in made if reached <= error], default=own)
            row["ratio_at_its_error"] = f"{own / best:.2f}"


def print_means(rows) -> None:
    """Of each method at each tolerance, where a stiff one is chosen: mean and largest ratio at its error."""
    stiff = {(row["case"], row["rtol"]) for row in rows if row["chosen"] and row["method"] not in ("Dopri8", "Tsit5")}
    for family in FAMILIES:
        start = family.split(" c=")[0].split(" k=")[0]
        for rtol in RTOLS:
            for method in METHODS:
                own = [row for row in rows if (row["method"], float(row["rtol"])) == (method, rtol)]
                own = [row for row in own if row["case"].startswith(start) and (row["case"], row["rtol"]) in stiff]
                ratios = [float(row["ratio_at_its_error"]) for row in own if row["ratio_at_its_error"]]
                if ratios:
                    mean = np.exp(np.mean(np.log(ratios)))
                    print(f"{start}, {rtol:.0e}, {method}: mean {mean:.2f}, at most {max(ratios):.2f} at equal error")


def main() -> None:
    rows = []
    for title, (build, cases) in FAMILIES.items():
        runs = programs(build)
        for numbers in cases:
            label = title.format(*(f"{value:g}" for value in numbers))
            rows.extend(rows_of(label, build, tuple(map(float, numbers)), runs))
    write("automatic_choice", "python benchmarks/automatic_choice.py", rows)
    worst = max((row for row in rows if row["chosen"]), key=lambda row: float(row["ratio_to_best"] or "inf"))
    traced = max((row for row in rows if row["method"] == TRACED), key=lambda row: float(row["ratio_to_best"] or "inf"))
    print(f"worst of traced numbers: {traced['ratio_to_best']} times, {traced['case']} at rtol {traced['rtol']}")
    print_means(rows)
    dearest = max((row for row in rows if row["chosen"]), key=lambda row: float(row["ratio_at_its_error"] or "inf"))
    print(
        f"worst at its error: {dearest['ratio_at_its_error']} times the fastest as exact, {dearest['case']} at "
        f"rtol {dearest['rtol']}"
    )
    print(f"worst of the choices: {worst['ratio_to_best']} times the best, {worst['case']} at rtol {worst['rtol']}")


if __name__ == "__main__":
    main()
