"""The figure of `against_others.py`: error over time, one panel for each case, from the CSV files in `results/`."""

import csv
from pathlib import Path

from machine import RESULTS
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

import spherejax as sj

LOOKS = {
    "spherejax Dopri8": ("#0072B2", "o", "-"),
    "spherejax Dop853": ("#332288", "<", "-"),
    "spherejax Rodas5P": ("#56B4E9", "s", "-"),
    "numba DOP853": ("#D55E00", "^", "-"),
    "numba + LSODA": ("#009E73", "v", (0, (4, 1.5))),
    "numba + CVODE BDF": ("#CC79A7", "D", (0, (4, 1.5))),
    "numba + SciPy Radau": ("#E69F00", "P", (0, (4, 1.5))),
    "Exudyn trapezoidal": ("#000000", "X", (0, (1, 1.2))),
}
"""Color, marker and dashes of each method; solid lines for the two sides that are compared."""

FLOOR = 1e-15


def rows_in(path: Path) -> list[dict]:
    """Rows of a CSV file below its comment lines."""
    with path.open() as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def draw(names: list[str], error: str = "error_max_m") -> Path:
    """Draw the panels of those cases whose CSV files exist."""
    tables = [rows_in(path) for path in (RESULTS / f"against_others_{name}.csv" for name in names) if path.exists()]
    n_columns = 2
    n_rows = -(-len(tables) // n_columns)
    title = (
        "Error of the rocker's height, largest of 21 samples, against time on one core\n"
        "(one line per method, tolerances 1e-4 to 1e-10; gray: less than two references differ by)"
    )
    figure, axes = sj.plot.new_figure(n_rows, n_columns, 9.5, 2.9 * n_rows + 0.6, title)
    seen = {}
    for ax, rows in zip(axes.flat, tables, strict=False):
        floor = float(rows[0]["references_differ_m"])
        for method, (color, marker, dashes) in LOOKS.items():
            own = [row for row in rows if row["method"].split(" (")[0] == method]
            if own:
                x = [float(row["milliseconds"]) for row in own]
                y = [max(float(row[error]), FLOOR) for row in own]
                width, size = (1.6, 5) if dashes == "-" else (1.1, 4)
                (line,) = ax.plot(x, y, color=color, marker=marker, ls=dashes, lw=width, ms=size, label=method)
                seen.setdefault(method, line)
        ax.axhspan(FLOOR, max(floor, FLOOR), color="0.92", zorder=0)
        ax.set(xscale="log", yscale="log", xlabel="milliseconds", ylabel="error [m]")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_title(rows[0]["case"], loc="left")
    for ax in axes.flat[len(tables) :]:
        ax.set_visible(False)
    sj.plot.letter(axes.flat[: len(tables)])
    handles = [seen[method] for method in LOOKS if method in seen]
    figure.legend(
        handles, [h.get_label() for h in handles], loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    path = RESULTS / "against_others.png"
    figure.savefig(path)
    return path
