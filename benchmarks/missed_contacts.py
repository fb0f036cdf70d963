"""Thousands of balls in dry sockets and hundreds of double pendulums: is any run wrong that says it succeeded?

    python benchmarks/missed_contacts.py            # 2,000 starts, 500 pendulums: half an hour
    python benchmarks/missed_contacts.py --starts 240 --pendulums 40

Starts are random: speeds from 0.005 to 5 m/s, clearances from 1e-6 to 5e-3 m, every normal law, with and without
friction, in three dimensions, some along gravity through the center, some spinning. Each is run by `sj.simulate` and in
the lanes of `sj.sweep`, at tolerances from 1e-4 to 1e-12, and judged by energy (none may be gained), by the wall (no
ball in flight is beyond it) and by the event-exact reference of `tests/event_exact.py`, as far as the tolerance, grown
by the motion's own sensitivity, lets them be compared. Every failure prints its seed.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from machine import use_one_core, write

use_one_core()
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import elbow_reference  # noqa: E402
import numpy as np  # noqa: E402
import socket_starts  # noqa: E402

import spherejax as sj  # noqa: E402

RTOLS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
GROUP = 8


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--starts", type=int, default=2000)
    options.add_argument("--pendulums", type=int, default=500)
    options.add_argument("--first-seed", type=int, default=0)
    options = options.parse_args()
    per_laws = -(-options.starts // (GROUP * len(socket_starts.ALL_LAWS)))
    rows = []
    for i, laws in enumerate(socket_starts.ALL_LAWS):
        first = options.first_seed + i * per_laws
        rows += balls(laws, range(first, first + per_laws))
    per_laws = -(-options.pendulums // (GROUP * len(ELBOWS)))
    for i, laws in enumerate(ELBOWS):
        first = options.first_seed + i * per_laws
        rows.append(pendulums(laws, range(first, first + per_laws)))
    write("missed_contacts", "python benchmarks/missed_contacts.py", rows)


def balls(laws: socket_starts.Laws, seeds) -> list[dict[str, object]]:
    """Rows of one set of laws: by `sj.simulate`, and in lanes."""
    counts = {way: Counter() for way in ("simulate", "lanes")}
    seconds: Counter = Counter()
    for seed in seeds:
        random = np.random.default_rng(seed)
        rtol = RTOLS[seed % len(RTOLS)]
        starts, ts = socket_starts.draw(random, GROUP)
        begin = time.perf_counter()
        references = [socket_starts.exact(laws, s, ts, rtol, random) for s in starts]
        seconds["reference"] += time.perf_counter() - begin
        for way in counts:
            begin = time.perf_counter()
            runs = RUNS[way](laws, starts, ts, rtol)
            seconds[way] += time.perf_counter() - begin
            for i, (numbers, run, reference) in enumerate(zip(starts, runs, references, strict=True)):
                verdict = socket_starts.judge(numbers, ts, rtol, run, reference)
                counted(counts[way], verdict)
                if verdict.is_silently_wrong:
                    print(f"  {laws} seed {seed} start {i} rtol {rtol:.0e} {way}: {verdict}", flush=True)
    return [row(f"ball, {laws}", w, counts[w], seconds[w]) for w in counts]


def pendulums(laws: socket_starts.Laws, seeds) -> dict[str, object]:
    """The row of double pendulums whose elbow has these laws."""
    counts, seconds = Counter(), 0.0
    for seed in seeds:
        random, rtol = np.random.default_rng(seed), RTOLS[seed % len(RTOLS)]
        starts, ts = elbow_reference.draw(random, GROUP)
        for i, numbers in enumerate(starts):
            reference = elbow_reference.exact(laws, numbers, ts, rtol, random)
            begin = time.perf_counter()
            run = elbow_reference.single(laws, numbers, ts, rtol)
            seconds += time.perf_counter() - begin
            verdict = elbow_reference.judge(numbers, ts, rtol, run, reference)
            counted(counts, verdict)
            if verdict.is_silently_wrong:
                print(f"  pendulum, {laws} seed {seed} start {i} rtol {rtol:.0e}: {verdict}", flush=True)
    return row(f"double pendulum, {laws}", "simulate", counts, seconds)


def one_by_one(laws, starts, ts, rtol):
    return [socket_starts.single(laws, numbers, ts, rtol) for numbers in starts]


ELBOWS = (
    socket_starts.Laws("LankaraniNikravesh", friction=False),
    socket_starts.Laws("Flores", friction=True),
    socket_starts.Laws("ExactRestitution", friction=False),
)
RUNS = {"simulate": one_by_one, "lanes": socket_starts.in_lanes}


def counted(counts: Counter, verdict) -> None:
    """Add one verdict."""
    counts["runs"] += 1
    succeeded = verdict.status == sj.Status.SUCCEEDED
    counts["succeeded"] += succeeded
    counts["failed_with_status"] += not succeeded
    counts["succeeded_with_gain"] += succeeded and verdict.gains
    counts["succeeded_beyond_wall"] += succeeded and verdict.passes_wall
    counts["succeeded_off_reference"] += succeeded and verdict.disagrees
    counts["silently_wrong"] += verdict.is_silently_wrong


COLUMNS = (
    "runs",
    "succeeded",
    "failed_with_status",
    "succeeded_with_gain",
    "succeeded_beyond_wall",
    "succeeded_off_reference",
    "silently_wrong",
)


def row(name: str, way: str, counts: Counter, seconds: float) -> dict[str, object]:
    """One line of the table."""
    found = {"scene": name, "way": way, **{key: counts[key] for key in COLUMNS}, "seconds": f"{seconds:.1f}"}
    print(found, flush=True)
    return found


if __name__ == "__main__":
    main()
