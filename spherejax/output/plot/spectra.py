"""Amplitudes of a quantity of a run by frequency."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, new_figure, note

if TYPE_CHECKING:
    import xarray


CONTENT = 0.005
"""Amplitudes below this share of the largest are no content: on the figure they lie on the axis."""


FLAT = 0.03
"""Peaks lower than this share of the largest lie on a linear axis, which is logarithmic then."""


def _is_logarithmic(frequencies: np.ndarray, lines: np.ndarray, reach: float) -> bool:
    """Whether the highest amplitude in the upper half of the frequencies shown would lie on a linear axis."""
    rows = np.abs(lines).max(axis=1)
    upper = rows[(frequencies > 0.5 * reach) & (frequencies <= reach)]
    return bool(upper.size and CONTENT * np.nanmax(rows) < upper.max() < FLAT * np.nanmax(rows))


def _reach(frequencies: np.ndarray, lines: np.ndarray) -> float:
    """The frequency [Hz] up to which there is content, and a tenth more; all of them where the last ones have some."""
    rows = np.abs(lines).max(axis=1)
    there = np.flatnonzero(rows > CONTENT * np.nanmax(rows, initial=0.0))
    last = float(frequencies.max())
    return last if not there.size else min(last, max(1.1 * float(frequencies[there[-1]]), float(frequencies[1])))


def spectrum(found: "xarray.Dataset", title: str = "") -> Figure:
    """Amplitude by frequency, a line for each component; the mean is taken off and is not drawn.

    The frequencies reach as far as there is content: up to a tenth beyond the last amplitude above 0.5 % of the
    largest, which the figure says. `found` has all of them. Amplitudes are logarithmic where the upper half of these
    frequencies has content that would lie on a linear axis.

    Args:
        found: what `run.spectrum("reaction.elbow.z")` gives.
        title: what is shown; the quantity and the length of the run when empty.
    """
    amplitude = found["amplitude"]
    quantity = str(found.attrs["quantity"])
    figure, axes = new_figure(1, 1, 7.0, 4.0, title or f"{quantity}: spectrum of {found.attrs['duration']:.6g} s")
    ax = axes[0, 0]
    lines = amplitude.transpose("frequency", ...).values.reshape(amplitude.sizes["frequency"], -1)
    names = [f"{quantity}.{axis}" for axis in np.atleast_1d(found["axis"].values)] if lines.shape[1] > 1 else [quantity]
    for name, line, color, dashes in zip(names, lines.T, LAW_COLORS, LAW_DASHES, strict=False):
        ax.plot(found["frequency"], line, color=color, ls=dashes, lw=1.2, label=name)
    frequencies = np.asarray(found["frequency"], float)
    reach, last = _reach(frequencies, lines), float(frequencies.max())
    ax.set_xlim(0.0, reach)
    if reach < last:
        note(ax, f"below {CONTENT:.1%} of the largest from {reach:.4g} to {last:.4g} Hz", place=(0.99, 0.98))
    if _is_logarithmic(frequencies, lines, reach):
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.1 * CONTENT * float(np.nanmax(np.abs(lines))))
    else:
        ax.set_ylim(bottom=0.0)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"amplitude [{amplitude.attrs['units']}]")
    if len(names) > 1:
        legend_below(figure, ax)
    return figure
