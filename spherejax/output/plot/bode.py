"""Frequency responses: magnitude and phase over frequency."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, letter, new_figure, repeated

if TYPE_CHECKING:
    import xarray


def bode(responses: "xarray.DataArray | Mapping[str, xarray.DataArray]", title: str = "Frequency response") -> Figure:
    """Magnitude and phase over frequency: a color for each output and input, a dash for each response.

    Args:
        responses: `sj.linearize(...).frequency_response(f)`, or several by what the legend says.
        title: what is shown.

    Raises:
        SceneError: for what is no frequency response.
    """
    named: Mapping[str, Any] = responses if isinstance(responses, Mapping) else {"": responses}
    if not named or any(getattr(one, "dims", ()) != ("frequency", "output", "input") for one in named.values()):
        raise SceneError(
            "bode draws what frequency_response returns; give it, or several by name: {'soft': response, ...}"
        )
    figure, axes = new_figure(2, 1, 7.0, 5.4, title)
    upper, lower = axes[:, 0]
    first = next(iter(named.values()))
    pairs = [(str(o), str(i)) for o in first["output"].values for i in first["input"].values]
    colors = dict(zip(pairs, repeated(LAW_COLORS, len(pairs)), strict=True))
    for (name, response), dash in zip(named.items(), repeated(LAW_DASHES, len(named)), strict=True):
        f = np.asarray(response["frequency"])
        for output, into in pairs:
            values = np.asarray(response.sel(output=output, input=into))
            said = f"{output} by {into}" if not name else name if len(pairs) == 1 else f"{name}: {output} by {into}"
            look = {"color": colors[output, into], "ls": dash, "lw": 1.4}
            shown = np.abs(values) > 0
            upper.plot(f, np.where(shown, np.abs(values), np.nan), label=said, **look)
            phase = np.degrees(np.unwrap(np.angle(values))) if shown.all() else np.degrees(np.angle(values))
            lower.plot(f, np.where(shown, phase, np.nan), **look)
    for ax in (upper, lower):
        if np.all(np.asarray(first["frequency"]) > 0):
            ax.set_xscale("log")
            ax.xaxis.set_major_formatter("{x:g}")
    if any(np.any(np.asarray(response) != 0) for response in named.values()):
        upper.set_yscale("log")
    upper.set_ylabel("magnitude [SI units]")
    lower.set_ylabel("phase [deg]")
    lower.set_xlabel("frequency [Hz]")
    letter([upper, lower])
    legend_below(figure, upper)
    return figure
