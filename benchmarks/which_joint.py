"""Which joint is it? Synthetic four-bars with each model of the studied joint, and what `sj.compare_models` says.

    python benchmarks/which_joint.py              # 200 decisions, some 20 minutes on two cores
    python benchmarks/which_joint.py 1000         # more; decisions that are in the file already are not made again
    python benchmarks/which_joint.py 1000 500     # numbers 500 to 999, e.g. on another machine

A decision: one record of 1 s, the rocker's height at 500 instants with normal errors of 1 percent of its standard
deviation, of a four-bar whose studied joint is, in turn, ideal, dry, lubricated or a bushing. Its numbers are drawn
over the ranges in `TRUTHS`: by their logarithms, a restitution uniformly. The candidates search wider ranges,
`CANDIDATES`. The seed of a decision is its number.

Times are those of this process while it runs: wall-clock and processor time of one call, compilation of the first ones
included.
"""

import contextlib
import csv
import sys
import time
from typing import Any

import numpy as np
from machine import RESULTS, write

import spherejax as sj

COMMAND = "python benchmarks/which_joint.py"
NAME = "which_joint"
TS = np.linspace(0.002, 1.0, 500)
NOISE = 0.01
"""Standard deviation of the errors, a share of that of the motion."""


def ideal():
    return sj.gallery.four_bar(sj.Ideal())


def dry(clearance, restitution, mu):
    normal = sj.LankaraniNikravesh(restitution=restitution)
    return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu=mu)))


def film(clearance, viscosity):
    return sj.gallery.four_bar(sj.Lubricated(clearance, viscosity=viscosity))


def bushing(stiffness, damping):
    return sj.gallery.four_bar(sj.Bushing(stiffness, damping))


BUILDS = {"ideal": ideal, "dry": dry, "film": film, "bushing": bushing}
TRUTHS = {
    "ideal": {},
    "dry": {"clearance": (5e-5, 4e-4), "restitution": (0.5, 0.95), "mu": (0.02, 0.2)},
    "film": {"clearance": (5e-5, 4e-4), "viscosity": (0.02, 2.0)},
    "bushing": {"stiffness": (1e4, 1e6), "damping": (1e-4, 1e-2)},
}
"""Ranges of the numbers of the mechanisms: m, -, -; m, Pa s; N/m, s."""

CANDIDATES = {
    "ideal": ideal,
    "dry": sj.studies.Candidate(
        dry,
        {
            "clearance": sj.Parameter(1e-4, lower=3e-5, upper=6e-4),
            "restitution": sj.Parameter(0.8, lower=0.3, upper=1.0),
            "mu": sj.Parameter(0.05, lower=0.01, upper=0.3),
        },
    ),
    "film": sj.studies.Candidate(
        film,
        {
            "clearance": sj.Parameter(1e-4, lower=3e-5, upper=6e-4),
            "viscosity": sj.Parameter(0.2, lower=0.01, upper=5.0),
        },
    ),
    "bushing": sj.studies.Candidate(
        bushing,
        {
            "stiffness": sj.Parameter(1e5, lower=5e3, upper=5e6),
            "damping": sj.Parameter(1e-3, lower=5e-5, upper=2e-2),
        },
    ),
}


def drawn(kind, random):
    """Numbers of a mechanism."""
    numbers = {}
    for name, (low, high) in TRUTHS[kind].items():
        share = random.uniform()
        numbers[name] = low + (high - low) * share if name == "restitution" else low * (high / low) ** share
    return numbers


def record_of(seed):
    """The kind of a decision's mechanism, its numbers, and what was measured of it."""
    random = np.random.default_rng(seed)
    kind = list(BUILDS)[seed % len(BUILDS)]
    numbers = drawn(kind, random)
    run = sj.simulate(BUILDS[kind](**numbers), np.append(0.0, TS), rtol=1e-9)
    clean = np.asarray(run.position("rocker"))[1:, 2]
    noise = NOISE * float(np.std(clean))
    measured = sj.Measured(TS, {"position.rocker.z": clean + noise * random.normal(size=TS.size)}, noise=noise)
    return kind, numbers, measured


def decision(seed):
    kind, numbers, measured = record_of(seed)
    began, spent = time.perf_counter(), time.process_time()
    found = sj.compare_models(
        measured, CANDIDATES, draws=48, starts=3, rtol=1e-6, max_steps=20_000, rng=seed, progress=False
    )
    seconds, processor = time.perf_counter() - began, time.process_time() - spent
    rows = found.evidence
    truth = rows[kind]
    row = {
        "seed": seed,
        "truth": kind,
        "numbers": " ".join(f"{name}={value:.4g}" for name, value in numbers.items()),
        "best": found.best,
        "is_right": int(found.best == kind),
        "is_decided": int(found.is_decided),
        "alike": " ".join(found.alike),
        "disagree": int(bool(found.conflict)),
    }
    for name in BUILDS:
        row[f"residuals_{name}"] = f"{rows[name].residuals:.4g}"
        row[f"prediction_{name}"] = f"{rows[name].prediction:.4g}"
        row[f"criterion_{name}"] = f"{rows[name].criterion:.5g}"
        row[f"error_{name}"] = f"{rows[name].criterion_error:.3g}"
        row[f"held_out_{name}"] = f"{rows[name].held_out:.4g}"
    row["determined"] = f"{truth.n_determined:.2f}"
    row["failed"] = " ".join(name for name, one in rows.items() if one.diagnosis)
    row["wall_s"], row["processor_s"] = f"{seconds:.1f}", f"{processor:.1f}"
    return row


def known_rows():
    path = RESULTS / f"{NAME}.csv"
    if not path.exists():
        return []
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def confusion(rows):
    """How often each model was named, by that of the mechanism."""
    for kind in BUILDS:
        own = [row for row in rows if row["truth"] == kind]
        if not own:
            continue
        table = {"truth": kind, "decisions": len(own)}
        table |= {f"named_{name}": sum(row["best"] == name for row in own) for name in BUILDS}
        right = [row for row in own if int(row["is_right"])]
        table["right_percent"] = f"{100 * len(right) / len(own):.1f}"
        table["right_and_told_from_all_others"] = sum(int(row["is_decided"]) for row in right)
        table["wrong_and_told_from_all_others"] = sum(int(row["is_decided"]) for row in own if row not in right)
        table["median_processor_s"] = f"{np.median([float(row['processor_s']) for row in own]):.3g}"
        table["longest_processor_s"] = f"{max(float(row['processor_s']) for row in own):.3g}"
        yield table


def seed_of(row: dict[str, Any]) -> int:
    return int(row["seed"])


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    rows: list[dict[str, Any]] = known_rows()
    done = {seed_of(row) for row in rows}
    for seed in range(first, n):
        if seed not in done:
            rows.append(decision(seed))
            right = sum(int(row["is_right"]) for row in rows)
            print(f"{len(rows)} decisions, {right} right; the last: {rows[-1]}", flush=True)
            with contextlib.redirect_stdout(None):
                rows.sort(key=seed_of)
                write(NAME, COMMAND, rows)
    write(f"{NAME}_confusion", COMMAND, list(confusion(rows)))


if __name__ == "__main__":
    main()
