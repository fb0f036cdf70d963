"""How well the estimated error of a whole run meets its error, on ten scenes with references at 1e-13.

    python benchmarks/global_error.py            # five minutes

`run.error` compares a run with a companion at a hundredth of the tolerance. Here both are compared with a reference:
the same scene at `rtol=1e-13`, where a second reference by another method says how far it can be trusted, and for the
pendulum a closed form. The second table, `global_error_choices.csv`, has what other companions would give.
"""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import numpy as np
from machine import write
from scipy.special import ellipj, ellipk

import spherejax as sj

REFERENCE = 1e-13
RTOLS = (1e-6, 1e-8, 1e-10)
ALL_RTOLS = tuple(10.0 ** (-p / 2) for p in range(8, 23))
N_SAMPLES = 201
RESOLVED = 3.0
"""Errors below so many differences of the two references are not judged."""


class Case(NamedTuple):
    """A scene, its length [s], the quantity that is looked at, and its exact values where they are known."""

    scene: Callable[[], sj.Scene]
    t1: float
    name: str
    exact: Callable[[Any], np.ndarray] | None = None


def rod_of_pendulum(ts) -> np.ndarray:
    """The center of the gallery's physical pendulum, which is let go horizontally: sin(theta/2) = k cd(w t, k)."""
    body = sj.gallery.physical_pendulum().bodies["rod"]
    lever = float(np.linalg.norm(np.asarray(body.position)))
    moment = float(np.max(np.asarray(body.inertia)))
    w = math.sqrt(float(body.mass) * 9.81 * lever / (moment + float(body.mass) * lever**2))
    m = 0.5  # sin(90 degrees / 2) squared
    quarter = ellipk(m)
    sn, *_ = ellipj(np.mod(w * np.asarray(ts) + quarter, 4 * quarter), m)
    angle = 2 * np.arcsin(math.sqrt(m) * sn)  # from below, towards the side where it began
    return np.stack([lever * np.sin(angle), np.zeros_like(angle), -lever * np.cos(angle)], 1)


def rubber() -> sj.Scene:
    """The four-bar with a bushing that relaxes and has friction inside."""
    branches, friction = sj.laws.Maxwell(stiffness=[6e4, 5e4], time=[0.1, 0.01]), sj.laws.Berg(4.0, 1e-4)
    return sj.gallery.four_bar(sj.Bushing(1e5, 1e-3, branches=branches, friction=friction))


def dry_piston() -> sj.Scene:
    return sj.gallery.piston(sj.Dry(5e-4, conformity=sj.laws.JohnsonCylinder(0.02)))


four_bar = sj.gallery.four_bar
PERIOD = 4 * ellipk(0.5) / math.sqrt(9.81 / 0.2)

CASES = {
    "four-bar, ideal": Case(four_bar, 2.0, "position.rocker"),
    "four-bar, dry": Case(lambda: four_bar(sj.Dry(1e-4)), 0.2, "position.rocker"),
    "four-bar, friction": Case(
        lambda: four_bar(sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1))), 0.5, "eccentricity.coupler_rocker"
    ),
    "four-bar, film": Case(
        lambda: four_bar(sj.Lubricated(1e-4, viscosity=0.4)), 0.2, "eccentricity.coupler_rocker"
    ),
    "four-bar, bushing": Case(lambda: four_bar(sj.Bushing(1e6, 1e-4)), 0.5, "position.rocker"),
    "rubber": Case(rubber, 0.5, "reaction.coupler_rocker"),
    "piston, dry": Case(dry_piston, 0.024, "eccentricity.pin"),
    "pendulum, 10,000 periods": Case(
        sj.gallery.physical_pendulum, 10_000 * PERIOD, "position.rod", rod_of_pendulum
    ),
    "chain of six": Case(lambda: sj.gallery.chain(6), 3.0, "position.link_06"),
    "suspension": Case(sj.gallery.suspension, 2.0, "position.wheel"),
}  # fmt: skip


def values(run, name: str) -> np.ndarray:
    """A quantity at the samples, by the method of `Trajectory` that it is named after."""
    kind, owner = name.split(".", 1)
    return np.asarray(getattr(run, kind)(owner))


def size(values: np.ndarray) -> np.ndarray:
    """Norms, by sample."""
    return np.linalg.norm(values, axis=-1)


class Reference(NamedTuple):
    """What a case is judged by: values at the samples, and how far they can be trusted."""

    values: np.ndarray
    error: float


def reference_of(case: Case, ts) -> Reference:
    first = sj.simulate(case.scene(), ts, rtol=REFERENCE)
    if case.exact is not None:
        return Reference(case.exact(ts), 0.0)
    other = sj.solvers.Rodas4P() if "Rodas" in first.choice else diffrax.Tsit5()
    second = sj.simulate(case.scene(), ts, rtol=REFERENCE, solver=other)
    found = values(first, case.name)
    return Reference(found, float(np.max(size(found - values(second, case.name)))))


def judged(label: str, case: Case, rtol: float, ts, reference: Reference) -> dict[str, object]:
    """A row: the estimate against the error."""
    begin = time.process_time()
    run = sj.simulate(case.scene(), ts, rtol=rtol)
    np.asarray(run.ys)
    plain = time.process_time() - begin
    begin = time.process_time()
    estimate = size(run.error(case.name))
    more = time.process_time() - begin
    error = size(values(run, case.name) - reference.values)
    # Where an error is a millionth of the largest, it passes through zero, or has not begun.
    counts = (error > RESOLVED * reference.error) & (error > 1e-6 * error.max())
    shares = estimate[counts] / error[counts]
    steps = int(run.stats.n_steps)
    return {
        "scene": label,
        "quantity": case.name,
        "rtol": f"{rtol:.0e}",
        "error": f"{error.max():.2e}",
        "reference_error": f"{reference.error:.1e}",
        "estimate": f"{estimate.max():.2e}",
        "share": f"{estimate.max() / error.max():.2f}" if error.max() > RESOLVED * reference.error else "",
        "samples_within_three": f"{np.mean((shares > 1 / 3) & (shares < 3)):.3f}" if shares.size else "",
        "lowest_share": f"{shares.min():.2g}" if shares.size else "",
        "determined_until_s": f"{run.determined_until:.4g}",
        "steps": steps,
        "steps_of_companion": f"{int(run.global_error.companion.stats.n_steps) / steps:.2f}",
        "processor_time_of_error": f"{more / plain:.1f}",
    }


def choices(cases: dict[str, tuple[Case, Any, Reference]]) -> list[dict[str, object]]:
    """What companions at other tolerances, and by another method, would estimate."""
    rows = []
    companions = [("same", 0.5), ("same", 1.0), ("same", 1.5), ("same", 2.0), ("same", 3.0), ("other", 2.0)]
    runs: dict[tuple, tuple[np.ndarray, int]] = {}

    def run_of(label, case, ts, rtol, is_other):
        key = label, is_other, round(math.log10(rtol), 3)
        if key not in runs:
            scene = case.scene()
            stiff = "film" in label
            solver = (sj.solvers.Rodas4P() if stiff else sj.solvers.Dop853()) if is_other else None
            run = sj.simulate(scene, ts, rtol=rtol, solver=solver)
            runs[key] = values(run, case.name), int(run.stats.n_steps)
        return runs[key]

    for method, decades in companions:
        shares, steps = [], []
        for label, (case, ts, reference) in cases.items():
            for rtol in ALL_RTOLS:
                mine, n = run_of(label, case, ts, rtol, False)
                error = float(np.max(size(mine - reference.values)))
                if error <= RESOLVED * reference.error or rtol * 10**-decades < 5e-14:
                    continue
                other, m = run_of(label, case, ts, rtol * 10**-decades, method == "other")
                shares.append(float(np.max(size(mine - other))) / error)
                steps.append(m / n)
        found = np.array(shares)
        rows.append({
            "method": method,
            "tolerance": f"1/{10**decades:.0f}",
            "runs": len(found),
            "within_three": f"{np.mean((found > 1 / 3) & (found < 3)):.3f}",
            "below_a_tenth": int(np.sum(found < 0.1)),
            "lowest": f"{found.min():.2g}",
            "largest": f"{found.max():.2g}",
            "steps": f"{np.median(steps):.2f}",
        })  # fmt: skip
    return rows


def main() -> None:
    rows, short = [], {}
    for label, case in CASES.items():
        ts = np.linspace(0.0, case.t1, N_SAMPLES)
        reference = reference_of(case, ts)
        rows += [judged(label, case, rtol, ts, reference) for rtol in RTOLS]
        if label.startswith("pendulum"):  # a tenth of it: the loosest runs are off by whole turns
            case = case._replace(t1=case.t1 / 10)
            ts = np.linspace(0.0, case.t1, N_SAMPLES)
            reference = reference_of(case, ts)
        short[label] = case, ts, reference
    write("global_error", "python benchmarks/global_error.py", rows)
    write("global_error_choices", "python benchmarks/global_error.py", choices(short))


if __name__ == "__main__":
    main()
