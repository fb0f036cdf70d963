"""Identification: what a gradient costs, what a whole fit costs, and whether its intervals cover the truth.

    python benchmarks/identification.py                 # about 20 minutes
    python benchmarks/identification.py gradients       # one part: gradients, fits, coverage
    python benchmarks/identification.py fits dry        # of one problem: bushing, dry

Two problems on the four-bar, one core. Bushing: stiffness and damping from the rocker's height at 1 kHz for 0.5 s,
noise 1e-6 m. Dry: clearance, restitution and friction from the rocker's height and velocity through the first ten
onsets, noise 1e-7 m and 1e-5 m/s.

Gradients: of the cost (half the sum of squares of the weighted residuals) by the logarithms of the parameters, 3
percent away from the truth. The error is relative to forward sensitivities at rtol 1e-12. Central differences get the
best of five steps, which a user would not know. Times are the least processor times of several calls, without
compiling.

Fits: `sj.fit` against Nelder and Mead and Powell (SciPy) on the same compiled cost at the same tolerance, by the same
logarithms. `seconds` is when the best point so far comes, for good, within a tenth of a standard deviation of the
minimum in every parameter; empty if it never does. Compiling is not counted, but told. `Whole()` fits the whole record
at once, as the others do; by default the record grows, so that a start far away is not caught in a wrong minimum.
"""

import sys
import time

from machine import use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.optimize import minimize  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.studies.fit import Whole, problem_of  # noqa: E402

jax.config.update("jax_enable_compilation_cache", False)  # the times of first calls are those of compiling

COMMAND = "python benchmarks/identification.py"
REPEATS = 5
STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Of central differences, in the logarithms."""

ONE_STEP = 1e-4
"""What a user would take, who does not try."""

NEAR = 0.1
"""Standard deviations within which a parameter counts as found."""

N_DRAWS = 100


class Bushing:
    """Two parameters of a smooth motion."""

    name = "bushing"
    truth = {"stiffness": 1e5, "damping": 1e-3}
    ts = np.linspace(1e-3, 0.5, 500)
    noise = {"position.rocker.z": 1e-6}
    starts = (1.03, 1.2, 2.0, 10.0)
    tolerances = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
    reverse = (1e-6, 1e-8)

    @staticmethod
    def build(stiffness, damping):
        return sj.gallery.four_bar(sj.Bushing(stiffness, damping))


class Dry:
    """Three parameters of a motion through ten onsets."""

    name = "dry"
    truth = {"clearance": 1e-4, "restitution": 0.9, "mu": 0.1}
    ts = np.linspace(5e-4, 0.046, 92)
    noise = {"position.rocker.z": 1e-7, "velocity.rocker.z": 1e-5}
    starts = (1.03, 1.1, 1.3)
    tolerances = (1e-6, 1e-8, 1e-10)
    reverse = (1e-6, 1e-8)

    @staticmethod
    def build(clearance, restitution, mu):
        normal = sj.LankaraniNikravesh(restitution=restitution)
        return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu=mu)))


PROBLEMS = {"bushing": Bushing, "dry": Dry}


def motion(case):
    """The measured observables without noise."""
    run = sj.simulate(case.build(**case.truth), np.concatenate([[0.0], case.ts]), rtol=1e-11)
    found = {"position.rocker.z": run.position("rocker"), "velocity.rocker.z": run.velocity("rocker")}
    values = {name: np.asarray(found[name])[1:, 2] for name in case.noise}
    if run.stats.n_onsets.size:
        print(f"{case.name}: {int(run.stats.n_onsets[0])} onsets in {case.ts[-1]:g} s")
    return values


def measured(case, values, seed=0):
    random = np.random.default_rng(seed)
    noisy = {name: clean + case.noise[name] * random.normal(size=clean.size) for name, clean in values.items()}
    return sj.Measured(case.ts, noisy, noise=case.noise)


def started(case, factor):
    """A start whose numbers are off by the factor, in turn up and down; a restitution stays below 1."""
    signs = (-1, 1, -1) if case.name == "bushing" else (1, -1, 1)
    return {name: value * factor**sign for (name, value), sign in zip(case.truth.items(), signs, strict=False)}


def least_seconds(call, repeats=REPEATS):
    """Least processor time of a call [s], after one warm-up, and the time of that first call."""
    begin = time.process_time()
    jax.block_until_ready(call())
    first = time.process_time() - begin
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        jax.block_until_ready(call())
        seconds.append(time.process_time() - begin)
    return min(seconds), first


# Gradients -----------------------------------------------------------------------------------------------------------


def by_sensitivities(case, start, data):
    """The gradient as a function of the logarithms and the tolerance; compiled once for all tolerances."""
    (experiment,) = problem_of(case.build, start, [data]).experiments

    @eqx.filter_jit
    def gradient(options, u):
        own = eqx.tree_at(lambda e: e.setting.options, experiment, options)
        found = own.predict(u)
        noise = jnp.array(list(case.noise.values()))
        return jnp.einsum("no,nok->k", (found.values - own.data) / noise, found.slopes / noise[:, None])

    def at(u, rtol):
        return gradient(problem_of(case.build, start, [data], rtol=rtol).experiments[0].setting.options, u)

    return gradient, at


def cost_of(case, data, adjoint=None):
    """The cost as a function of the logarithms and the tolerance, from plain runs."""
    ts = jnp.concatenate([jnp.zeros(1), jnp.asarray(case.ts)])

    def cost(u, rtol):
        parameters = dict(zip(case.truth, jnp.exp(u), strict=True))
        run = sj.simulate(case.build(**parameters), ts, rtol=rtol, adjoint=adjoint, max_steps=100_000)
        found = {"position.rocker.z": run.position("rocker"), "velocity.rocker.z": run.velocity("rocker")}
        errors = [(found[name][1:, 2] - data.values[name]) / case.noise[name] for name in case.noise]
        return sum(jnp.sum(error**2) for error in errors) / 2

    return cost


def gradients(case):
    data = measured(case, motion(case))
    start = started(case, 1.03)
    u = jnp.log(jnp.array(list(start.values())))
    compiled, sensitive = by_sensitivities(case, start, data)
    begin = time.process_time()
    reference = np.asarray(sensitive(u, 1e-12))
    compiling = time.process_time() - begin
    floor = float(np.linalg.norm(np.asarray(sensitive(u, 1e-11)) - reference) / np.linalg.norm(reference))

    def row(method, rtol, step, seconds, first, gradient):
        error = float(np.linalg.norm(gradient - reference) / np.linalg.norm(reference))
        found = {
            "problem": case.name,
            "parameters": len(case.truth),
            "method": method,
            "rtol": f"{rtol:.0e}",
            "step": step,
            "milliseconds": f"{1e3 * seconds:.3g}",
            "relative_error": f"{error:.1e}",
            "compile_s": f"{first:.1f}",
            "reference_good_to": f"{floor:.0e}",
        }
        print(found, flush=True)
        return found

    for rtol in case.tolerances:
        options = problem_of(case.build, start, [data], rtol=rtol).experiments[0].setting.options
        seconds = least_seconds(lambda: compiled(options, u))[0]  # noqa: B023
        yield row("forward sensitivities", rtol, "", seconds, compiling, np.asarray(sensitive(u, rtol)))
    cost = jax.jit(cost_of(case, data))
    compiling = least_seconds(lambda: cost(u, 1e-8), 1)[1]
    for rtol in (*case.tolerances, 1e-11):
        seconds = 2 * len(case.truth) * least_seconds(lambda: cost(u, rtol))[0]  # noqa: B023
        found = {step: differences(lambda v: cost(v, rtol), u, step) for step in STEPS}  # noqa: B023
        best = min(STEPS, key=lambda step: np.linalg.norm(found[step] - reference))
        yield row("central differences, best step", rtol, f"{best:.0e}", seconds, compiling, found[best])
        yield row("central differences, one step", rtol, f"{ONE_STEP:.0e}", seconds, compiling, found[ONE_STEP])
    reverse = jax.jit(jax.grad(cost_of(case, data, diffrax.RecursiveCheckpointAdjoint())))
    compiling = least_seconds(lambda: reverse(u, 1e-8), 1)[1]
    for rtol in case.reverse:
        seconds = least_seconds(lambda: reverse(u, rtol))[0]  # noqa: B023
        yield row("reverse (checkpoints)", rtol, "", seconds, compiling, np.asarray(reverse(u, rtol)))


def differences(cost, u, step):
    steps = step * np.eye(u.size)
    return np.array([float(cost(u + h) - cost(u - h)) / (2 * step) for h in steps])


# Whole fits ----------------------------------------------------------------------------------------------------------


class Log:
    """The best point so far, along time."""

    def __init__(self):
        self.rows, self.best, self.began = [], np.inf, time.process_time()

    def __call__(self, u, cost):
        if cost <= self.best or not self.rows:
            self.best = cost
            self.rows.append((time.process_time() - self.began, np.array(u), cost))

    def found_after(self, target, deviations):
        """When the best point comes within reach of the minimum for good [s], or None."""
        near = [bool(np.all(np.abs(u - target) < NEAR * deviations)) for _, u, _ in self.rows]
        if not near or not near[-1]:
            return None
        away = [i for i, each in enumerate(near) if not each]
        return self.rows[away[-1] + 1 if away else 0][0]


def fits(case, rtol=1e-8):
    data = measured(case, motion(case))
    begin = time.process_time()
    minimum = sj.fit(case.build, case.truth, data, rtol=rtol, progress=False)
    first = time.process_time() - begin
    target = np.log(list(minimum.estimates.values()))
    deviations = np.array(list(minimum.standard_deviations.values())) / np.exp(target)
    compiled = jax.jit(cost_of(case, data))
    _, compiling = least_seconds(lambda: compiled(jnp.asarray(target), rtol), 1)
    for factor in case.starts:
        start = started(case, factor)
        for method, horizon in (("sj.fit", None), ("sj.fit, Whole()", Whole())):
            yield by_gradients(case, method, horizon, data, start, factor, target, deviations, rtol, first)
        for method in ("Nelder-Mead", "Powell"):
            yield derivative_free(
                case, method, lambda u: compiled(u, rtol), start, factor, target, deviations, compiling
            )


def by_gradients(case, method, horizon, data, start, factor, target, deviations, rtol, compiling):
    log = Log()

    def seen(now):
        log(np.log(now.values), -len(log.rows))

    begin = time.process_time()
    fitted = sj.fit(case.build, start, data, horizon=horizon, rtol=rtol, progress=seen)
    log(np.log(list(fitted.estimates.values())), -np.inf)
    took = time.process_time() - begin
    return fit_row(case, method, factor, log, target, deviations, took, fitted.n_iterations, compiling)


def derivative_free(case, method, cost, start, factor, target, deviations, compiling):
    log, count = Log(), [0]

    def value(u):
        count[0] += 1
        found = float(cost(jnp.asarray(u)))
        found = found if np.isfinite(found) else 1e30
        log(u, found)
        return found

    u0 = np.log(list(start.values()))
    options = {"maxfev": 2000, "xatol": 1e-6, "fatol": 1e-3} if method == "Nelder-Mead" else {"maxfev": 2000}
    begin = time.process_time()
    minimize(value, u0, method=method, options=options)
    return fit_row(case, method, factor, log, target, deviations, time.process_time() - begin, count[0], compiling)


def fit_row(case, method, factor, log, target, deviations, took, runs, compiling):
    _, u, _ = log.rows[-1]
    found = log.found_after(target, deviations)
    row = {
        "problem": case.name,
        "method": method,
        "start_off_by": factor,
        "seconds": "" if found is None else f"{found:.3g}",
        "seconds_until_it_stops": f"{took:.3g}",
        "runs_or_iterations": runs,
        "largest_error_in_deviations": f"{np.max(np.abs(u - target) / deviations):.2g}",
        "largest_error_percent": f"{100 * np.max(np.abs(np.expm1(u - target))):.2g}",
        "first_call_s": f"{compiling:.1f}",
    }
    print(row, flush=True)
    return row


# Coverage ------------------------------------------------------------------------------------------------------------


def coverage(case):
    values = motion(case)
    start = started(case, 1.1)
    covered = dict.fromkeys(case.truth, 0)
    seconds, failed, scaled = [], 0, {name: [] for name in case.truth}
    for seed in range(N_DRAWS):
        begin = time.process_time()
        fitted = sj.fit(case.build, start, measured(case, values, seed), progress=False)
        seconds.append(time.process_time() - begin)
        failed += not fitted.succeeded
        intervals = fitted.interval(0.95)
        for name, truth in case.truth.items():
            covered[name] += intervals[name][0] <= truth <= intervals[name][1]
            scaled[name].append((fitted.estimates[name] - truth) / fitted.standard_deviations[name])
    for name in case.truth:
        row = {
            "problem": case.name,
            "parameter": name,
            "draws": N_DRAWS,
            "covered_by_95_percent_intervals": covered[name],
            "mean_error_in_deviations": f"{np.mean(scaled[name]):.2f}",
            "spread_of_errors_in_deviations": f"{np.std(scaled[name]):.2f}",
            "failed": failed,
            "median_seconds_a_fit": f"{np.median(seconds[1:]):.3g}",
            "first_fit_s": f"{seconds[0]:.3g}",
        }
        print(row, flush=True)
        yield row


PARTS = {"gradients": gradients, "fits": fits, "coverage": coverage}


def main() -> None:
    parts = [name for name in PARTS if name in sys.argv[1:]] or list(PARTS)
    cases = [case for name, case in PROBLEMS.items() if name in sys.argv[1:]] or list(PROBLEMS.values())
    for part in parts:
        for case in cases:
            rows = list(PARTS[part](case))
            write(f"identification_{part}_{case.name}", f"{COMMAND} {part} {case.name}", rows, ("scipy",))


if __name__ == "__main__":
    main()
