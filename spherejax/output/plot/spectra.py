"""Amplitudes of a quantity of a run by frequency."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, new_figure

if TYPE_CHECKING:
    import xarray


def spectrum(found: "xarray.Dataset", title: str = "") -> Figure:
    """Amplitude by frequency, a line for each component; the mean is taken off and is not drawn.

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
    ax.set_xlim(0.0, float(found["frequency"].max()))
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"amplitude [{amplitude.attrs['units']}]")
    if len(names) > 1:
        legend_below(figure, ax)
    return figure
