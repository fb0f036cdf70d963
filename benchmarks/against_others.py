"""Work against precision: spherejax and what a careful user would write, the same equations, one core each.

    python benchmarks/against_others.py                       # every case, a quarter of an hour
    python benchmarks/against_others.py ideal dry_short       # some cases
    python benchmarks/against_others.py --quick               # three tolerances
    python benchmarks/against_others.py --figure              # only draw the figure from the CSV files

Errors are those of the rocker's height, at the end and the largest at 21 samples, against the hand-written DOP853 at a
tolerance of 1e-12; a tight spherejax run with another integrator says how good that reference is.
Needs the extra `benchmarks`; a package that is not installed is left out, and the run says so.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from machine import REPEATS, use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from baselines import others  # noqa: E402
from baselines.dop853 import integrator  # noqa: E402
from baselines.parameters import N_STATE, Problem, problem  # noqa: E402
from work_precision_figure import draw  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.model.system import compile_scene  # noqa: E402
from spherejax.motion.solvers.automatic import choose_solver  # noqa: E402

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
QUICK_TOLERANCES = (1e-4, 1e-6, 1e-8)
EXUDYN_STEPS = (2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
PACKAGES = ("numba", "scipy", "numbalsoda", "scikit-sundae", "exudyn")
HEIGHT = 16
"""Index of the rocker's height in the flat state."""

N_SAMPLES = 21
LONG = 1.0
"""Repeats end when they have taken this long [s]."""

PATIENCE = 2.5
"""After a run longer than this [s] the method's tighter tolerances are left out."""


class Case(NamedTuple):
    """A scene and a duration [s], the tightest useful tolerance of the reference, and who runs it."""

    title: str
    model: sj.joints.AbstractSphericalModel
    duration: float
    tight: float
    methods: tuple[str, ...]


OURS = {"Dopri8": diffrax.Dopri8(), "Dop853": sj.solvers.Dop853(), "Rodas5P": sj.solvers.Rodas5P()}
_FREE = ("Dopri8", "DOP853", "LSODA", "CVODE", "Radau")
_friction = sj.Dry(1e-4, friction=sj.Threlfall())
_film = sj.Lubricated(
    1e-4, film=sj.laws.RadialFilm(), normal=sj.LankaraniNikravesh(0.9)
)  # the hand-written equations have the paper's
CASES = {
    "ideal": Case("ideal, 2 s", sj.Ideal(), 2.0, 1e-13, (*_FREE, "Rodas5P", "Exudyn")),
    "bushing": Case("bushing k 1e6 N/m, b 1e-4 s, 2 s", sj.Bushing(1e6, 1e-4), 2.0, 1e-12, (*_FREE, "Rodas5P")),
    "stiff_bushing": Case(
        "bushing k 1e6 N/m, b 1e-2 s, 2 s", sj.Bushing(1e6, 1e-2), 2.0, 1e-11, ("Rodas5P", "Dop853", *_FREE)
    ),
    "dry_short": Case(
        "dry with friction, c 0.1 mm, 0.2 s", _friction, 0.2, 1e-12, ("Dopri8", "Rodas5P", "DOP853", "CVODE")
    ),
    "dry_long": Case("dry with friction, c 0.1 mm, 2 s", _friction, 2.0, 1e-12, ("Dopri8", "DOP853", "CVODE")),
    "film_short": Case("lubricated, c 0.1 mm, 0.2 s", _film, 0.2, 1e-11, ("Rodas5P", *_FREE)),
    "film_long": Case("lubricated, c 0.1 mm, 1 s", _film, 1.0, 1e-10, ("Rodas5P", "Dopri8", "DOP853", "CVODE")),
}


class Run(NamedTuple):
    """What a method returns: heights at the samples [m], and steps where it tells."""

    heights: np.ndarray
    steps: int | None = None


Method = Callable[[float], Run]
"""A method at one case: from a tolerance (Exudyn: a step size) to a run."""


def by_spherejax(case: Case, solver: diffrax.AbstractSolver) -> Method:
    """A compiled call of `simulate`; the tolerance is an argument of it."""

    @jax.jit
    def run(tolerance, ts):
        motion = sj.simulate(sj.gallery.four_bar(case.model), ts, rtol=tolerance, atol=tolerance * 1e-3, solver=solver)
        return motion.position("rocker")[:, 2], motion.stats.n_steps

    ts = jnp.asarray(times(case))

    def call(tolerance):
        heights, steps = jax.block_until_ready(run(tolerance, ts))
        return Run(np.asarray(heights), int(steps))

    return call


def by_hand(case: Case, numbers: Problem) -> Method:
    """The hand-written DOP853."""
    run, ts = integrator(numbers.kind), times(case)

    def call(tolerance):
        ys = np.empty((N_SAMPLES, N_STATE))
        steps, _ = run(numbers.y0, ts, tolerance, tolerance * 1e-3, numbers.parameters, ys)
        return Run(ys[:, HEIGHT], steps)

    return call


def by_package(case: Case, numbers: Problem, runner) -> Method:
    """The hand-written right-hand side with another integrator."""
    ts = times(case)
    return lambda tolerance: Run(runner(numbers, ts, tolerance, tolerance * 1e-3)[:, HEIGHT])


def by_exudyn(case: Case) -> Method:
    """Exudyn's own model."""
    from baselines.exudyn_four_bar import runner

    run, ts = runner(case.model), times(case)
    return lambda step: Run(run(step, ts), round(case.duration / step))


def times(case: Case) -> np.ndarray:
    """The 21 sample times [s]."""
    return np.linspace(0.0, case.duration, N_SAMPLES)


def choice_for(case: Case) -> diffrax.AbstractSolver:
    """The integrator that `simulate` chooses."""
    return choose_solver(compile_scene(sj.gallery.four_bar(case.model)).system).solver


def methods_of(case: Case) -> Iterator[tuple[str, Method]]:
    """Label and method of all that run this case; the integrator that `simulate` chooses is marked."""
    numbers = problem(case.model)
    chosen = type(choice_for(case)).__name__
    for name in case.methods:
        if name in OURS:
            yield f"spherejax {name}{' (its choice)' if name == chosen else ''}", by_spherejax(case, OURS[name])
        elif name == "DOP853":
            yield "numba DOP853", by_hand(case, numbers)
        elif name == "Exudyn":
            yield "Exudyn trapezoidal", by_exudyn(case)
        else:
            label = {"LSODA": "numba + LSODA", "CVODE": "numba + CVODE BDF", "Radau": "numba + SciPy Radau"}[name]
            yield label, by_package(case, numbers, getattr(others, name.lower()))


def timed(method: Method, setting: float) -> tuple[Run, float]:
    """A run and its median time [s] of five; of fewer for a long one."""
    seconds: list[float] = []
    while not seconds or (len(seconds) < REPEATS and sum(seconds) < LONG):
        begin = time.perf_counter()
        run = method(setting)
        seconds.append(time.perf_counter() - begin)
    return run, float(np.median(seconds))


def rows_of(case: Case, quick: bool) -> list[dict]:
    """Every method at every tolerance, with errors."""
    reference = by_hand(case, problem(case.model))(case.tight).heights
    is_stiff = isinstance(choice_for(case), sj.solvers.Rodas5P)
    other = by_spherejax(case, sj.solvers.Rodas5P() if is_stiff else diffrax.Dopri5())
    loose = max(case.tight, 1e-9 if is_stiff else 1e-11)
    difference = np.abs(other(loose).heights - reference)
    print(f"{case.title}: references differ by {difference[-1]:.1e} m at the end, {difference.max():.1e} m at most")
    rows = []
    for label, method in methods_of(case):
        settings = EXUDYN_STEPS if "Exudyn" in label else QUICK_TOLERANCES if quick else TOLERANCES
        is_warm = False
        for setting in settings:
            try:
                if not is_warm:
                    method(setting)  # what is compiled serves every tolerance
                is_warm = True
                run, seconds = timed(method, setting)
            except ModuleNotFoundError as error:
                print(f"  {label}: left out, {error.name} is not installed", flush=True)
                break
            except RuntimeError as error:
                print(f"  {label} at {setting:.0e}: {error}", flush=True)
                continue
            error = np.abs(run.heights - reference)
            rows.append(
                {
                    "case": case.title,
                    "method": label,
                    "tolerance_or_step": f"{setting:.0e}",
                    "milliseconds": f"{seconds * 1e3:.3f}",
                    "steps": "" if run.steps is None else run.steps,
                    "us_per_step": "" if run.steps is None else f"{seconds / run.steps * 1e6:.2f}",
                    "error_end_m": f"{error[-1]:.1e}",
                    "error_max_m": f"{error.max():.1e}",
                    "references_differ_m": f"{difference.max():.1e}",
                }
            )
            print("  " + ", ".join(str(rows[-1][key]) for key in list(rows[-1])[1:8]), flush=True)
            if seconds > PATIENCE:
                break
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all when none is named")
    parser.add_argument("--quick", action="store_true", help="three tolerances instead of seven")
    parser.add_argument("--figure", action="store_true", help="only draw the figure from the CSV files")
    arguments = parser.parse_args()
    unknown = set(arguments.cases) - set(CASES)
    if unknown:
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    for name in [] if arguments.figure else arguments.cases or CASES:
        begin = time.perf_counter()
        rows = rows_of(CASES[name], arguments.quick)
        command = f"python benchmarks/against_others.py {name}{' --quick' if arguments.quick else ''}"
        write(f"against_others_{name}", command, rows, PACKAGES)
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    print(draw(list(CASES)))


if __name__ == "__main__":
    main()
