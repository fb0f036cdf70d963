"""One look for all figures: colors, lines, labels with units, and axes that a spike does not flatten."""

import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError

RESOLUTION = 150
"""Dots per inch of the figures."""

MODEL_COLORS = {
    "ideal": "#000000",
    "dry": "#D55E00",
    "friction": "#0072B2",
    "lubricated": "#009E73",
    "bushing": "#CC79A7",
}
"""A color for each joint model, from the palette of Okabe and Ito (2008), which survives color blindness."""

OTHER_COLORS = ("#E69F00", "#56B4E9", "#882255", "#44AA99", "#332288", "#999933", "#AA4499", "#117733", "#888888")
"""For models with names of their own, in this order; of the palettes of Okabe and Ito, and of Tol (2021)."""

FILM_COLORS = ("#56B4E9", MODEL_COLORS["lubricated"])
"""Colors of the paper's film and of the full one, which is that of the lubricated joint in all other figures."""

LAW_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colors of things without an order, such as laws; of the same palette."""

LAW_DASHES = ("-", (0, (6, 2)), (0, (3, 1.5)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)), (0, (2, 2, 4, 2)))
"""Dashes that tell laws apart where their curves coincide or the print has no color."""

LABELS = {"t": "time [s]"}
"""Of axes, with units."""


_POWER = re.compile(r"(?<![\w.$])(?P<mantissa>\d+(?:\.\d+)?)e(?P<sign>[+-]?)0*(?P<exponent>\d+)(?![\w.])")
"""A number with a power of ten, as Python prints it."""


def typeset(text: str) -> str:
    """Numbers as `1e+06` or `2.5e-3` as powers of ten; the rest of the text as it is."""

    def powers(found: re.Match) -> str:
        sign, exponent = "-" if found["sign"] == "-" else "", found["exponent"]
        factor = "" if float(found["mantissa"]) == 1 else rf"{found['mantissa']} \times "
        return f"${factor}10^{{{sign}{exponent}}}$"

    return _POWER.sub(powers, text)


def typeset_number(value: float) -> str:
    """A number for an axis: 0.01 and 400 as they are, beyond 0.001 and 1000 with a power of ten."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:g}"
    mantissa, _, exponent = f"{value:.5e}".partition("e")
    return typeset(f"{float(mantissa):g}e{exponent}")


def number_decades(axis: Axis, shown: np.ndarray) -> None:
    """Ticks of a logarithmic axis as plain numbers; within one decade at round numbers, not at its powers of ten.

    Args:
        axis: one of a panel's two.
        shown: what is drawn along it, positive.
    """
    if np.max(shown) < 10 * np.min(shown):
        axis.set_major_locator(MaxNLocator(6))
        axis.set_minor_locator(NullLocator())
    elif np.max(shown) < 1e3 * np.min(shown):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: typeset_number(float(f"{value:.6g}"))))
    axis.set_minor_formatter(NullFormatter())


class Picture(Figure):
    """A figure that a notebook shows as it is, also where pyplot was never imported; its numbers are typeset."""

    def draw(self, renderer) -> None:
        """Draw, with powers of ten in titles, legends and remarks as such."""
        self._typeset()
        super().draw(renderer)

    def savefig(self, fname, **options) -> None:
        """Write the figure as matplotlib's method does, but in a quarter of the time, and files whole or not at all.

        matplotlib draws the whole figure once only to lay it out, which is left out here.

        Args:
            fname: path or file.
            **options: of `matplotlib.figure.Figure.savefig`.
        """
        if isinstance(fname, str | os.PathLike):
            # matplotlib adds the suffix of its format where a path has none.
            path = Path(fname)
            if not path.suffix:
                path = path.with_name(f"{path.name}.{options.get('format') or rcParams['savefig.format']}")
            with draft_of(path) as draft:
                self._savefig(draft, options)
        else:
            self._savefig(fname, options)

    def _savefig(self, fname: Any, options: dict[str, Any]) -> None:
        engine, as_format = self.get_layout_engine(), options.get("format")
        is_png = as_format == "png" or (as_format is None and str(fname).endswith(".png"))
        # With other options, such as a resolution, the layout may be another one.
        is_usual = is_png and not options.keys() - {"format"} and rcParams["savefig.dpi"] == "figure"
        if engine is None or not is_usual or not isinstance(self.canvas, FigureCanvasAgg):
            super().savefig(fname, **options)
            return
        self._typeset()
        engine.execute(self)
        self.set_layout_engine("none")
        try:
            self.canvas.print_png(fname)
        finally:
            self.set_layout_engine(engine)

    def _typeset(self) -> None:
        for text in self.findobj(Text):
            if isinstance(text, Text):
                said = text.get_text()
                if "e" in said and (shown := typeset(said)) != said:
                    text.set_text(shown)

    def _repr_png_(self) -> bytes:
        """The picture."""
        file = BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()


def new_figure(n_rows: int, n_columns: int, width: float, height: float, title: str) -> tuple[Figure, np.ndarray]:
    """An empty figure with a grid of axes, in the look of all figures; a notebook shows it without pyplot.

    Args:
        n_rows: rows of axes, 1 or more.
        n_columns: columns of axes, 1 or more.
        width: [inch].
        height: [inch].
        title: what is shown, with the values of the parameters.

    Returns:
        The figure, and the axes, shape (n_rows, n_columns).

    Raises:
        SceneError: for a grid without axes.
    """
    if min(n_rows, n_columns) < 1:
        raise SceneError(
            f"a figure of {n_rows} rows and {n_columns} columns has nothing to show; give at least 1 and 1"
        )
    figure = Picture(figsize=(width, height), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(wrapped(title, width), fontsize=TITLE_SIZE)
    axes = figure.subplots(n_rows, n_columns, squeeze=False)
    for ax in axes.flat:
        dress(ax)
    return figure, axes


TITLE_SIZE, LEGEND_SIZE = 11, 8
"""Sizes of letters [pt]."""

LETTER, HANDLE = 0.56, 46.0
"""Average width of a letter over its size, and width of a line with its gaps in a legend [pt]."""


def wrapped(title: str, width: float) -> str:
    """A title whose lines are no wider than a figure [inch]; mathematics is taken for as wide as its text."""
    letters = max(10, int(72 * width / (LETTER * TITLE_SIZE)))
    return "\n".join(
        part
        for line in title.split("\n")
        for part in textwrap.wrap(line, letters, break_long_words=False, break_on_hyphens=False) or [""]
    )


def dress(ax: Axes) -> None:
    """Grid behind the curves, small tick labels, no box on the right and on top."""
    ax.grid(True, color="0.88", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8)
    ax.xaxis.label.set_fontsize(9)
    ax.yaxis.label.set_fontsize(9)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def ordered_colors(n: int) -> list:
    """Colors for `n` values of one parameter: from dark to light, without the palest that vanish on white.

    Args:
        n: how many.

    Returns:
        Red, green, blue and opacity of each, between 0 and 1.
    """
    return [colormaps["viridis"](position) for position in np.linspace(0.05, 0.78, n)]


def model_colors(kinds: Mapping[str, str]) -> dict[str, str]:
    """A color for each of several joint models, the same in all figures of them.

    Args:
        kinds: the kind of each model (ideal, dry, friction, lubricated or bushing; empty for another one), by its name.

    Returns:
        Colors by name: a model that is called as a kind, or is the first of its kind, has the color of that kind.
    """
    found = {name: MODEL_COLORS[name] for name in kinds if name in MODEL_COLORS}
    rest = iter(OTHER_COLORS * (1 + len(kinds) // len(OTHER_COLORS)))
    for name, kind in kinds.items():
        if name not in found:
            usual = MODEL_COLORS.get(kind)
            found[name] = usual if usual is not None and usual not in found.values() else next(rest)
    return found


def repeated(looks: Sequence, n: int) -> list:
    """As many colors or dashes as there are curves; they begin again where they end."""
    return list(islice(cycle(looks), n))


def letter(axes: Sequence[Axes]) -> None:
    """Put letters (a), (b), ... in front of the panels' titles, which stand on the left; a single panel needs none.

    Args:
        axes: the panels in reading order, e.g. `list(axes.flat)` of what `new_figure` returns; at most 16.
    """
    for character, ax in zip("abcdefghijklmnop", axes, strict=False):
        title = ax.get_title(loc="left")
        ax.set_title(f"({character}) {title}".rstrip() if len(axes) > 1 else title, loc="left", fontsize=9)


def limit_by_bulk(ax: Axes, curves: Sequence[np.ndarray], *, keep: float = 97.0, margin: float = 0.35) -> None:
    """Limit the vertical axis to the bulk of the curves, and say in the panel how far the peaks reach.

    Args:
        ax: the panel.
        curves: the values drawn in it.
        keep: percentage of the samples of every curve that stays inside.
        margin: room around them, as a share of their range.
    """
    finite = [values[np.isfinite(values)] for values in curves]
    finite = [values for values in finite if values.size]
    if not finite:
        return
    low = min(np.percentile(values, (100 - keep) / 2) for values in finite)
    high = max(np.percentile(values, 100 - (100 - keep) / 2) for values in finite)
    # A bulk of equal values (a body in free fall, or at rest) has no range, and Matplotlib warns of equal limits.
    size = max(abs(low), abs(high))
    gap = margin * (high - low if high - low > 1e-6 * size else 0.1 * size or 1.0)
    lowest, highest = min(v.min() for v in finite), max(v.max() for v in finite)
    bottom, top = max(low - gap, lowest - 0.05 * gap), min(high + gap, highest + 0.05 * gap)
    ax.set_ylim(bottom, top)
    if lowest < bottom - 0.05 * gap or highest > top + 0.05 * gap:
        note(ax, f"axis clipped; peaks from {lowest:.3g} to {highest:.3g}")


ABOVE_RIGHT, ABOVE_LEFT = (1.0, 1.01), (0.0, 1.01)
"""Places of remarks above a panel without a title on that side, where they cover no curve."""


def note(ax: Axes, text: str, *, place: tuple[float, float] = (0.99, 0.02)) -> None:
    """A small remark above a panel, or in a corner of it, on white so that curves do not run through it."""
    horizontal, vertical = ("right" if place[0] > 0.5 else "left"), ("top" if 0.5 < place[1] <= 1.0 else "bottom")
    ax.text(
        *place,
        text,
        transform=ax.transAxes,
        ha=horizontal,
        va=vertical,
        fontsize=7,
        color="0.25",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        zorder=10,
    )


def legend_under(ax: Axes, *, n_columns: int = 2, gap: float = 0.16) -> None:
    """The legend of one panel, below its axis, where it covers no curve.

    Args:
        ax: the panel.
        n_columns: of the legend.
        gap: between axis and legend, as a share of the panel's height.
    """
    ax.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -gap), ncols=n_columns, frameon=False)


def legend_below(figure: Figure, ax: Axes) -> None:
    """One legend for the whole figure, below its panels, where it covers nothing."""
    handles, labels = ax.get_legend_handles_labels()
    widest = (max(map(len, labels), default=0) * LETTER * LEGEND_SIZE + HANDLE) / 72
    n_columns = max(1, min(len(labels), 5, int(figure.get_figwidth() / widest)))
    figure.legend(handles, labels, loc="outside lower center", ncols=n_columns, fontsize=LEGEND_SIZE, frameon=False)
