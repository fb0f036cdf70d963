"""Computing time of the joint models against the ideal one (Fig. 21)."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from spherejax.output.plot.style import MODEL_COLORS, new_figure


def time_ratios(names: Sequence[str], ratios: Sequence[float], steps: Sequence[int], title: str) -> Figure:
    """A bar for each model on a logarithmic axis, annotated with ratio and steps.

    Args:
        names: names of the models, the ideal one among them.
        ratios: computing time divided by that of the ideal model.
        steps: steps of the integrator.
        title: what is shown.
    """
    figure, axes = new_figure(1, 1, 6.8, 4.0, title)
    ax = axes[0, 0]
    ax.bar(names, ratios, color=[MODEL_COLORS.get(name, "0.5") for name in names], width=0.6)
    for position, (ratio, n_steps) in enumerate(zip(ratios, steps, strict=True)):
        text = f"{ratio:.3g}\n{n_steps:,} steps"
        ax.annotate(text, (position, ratio), (0, 3), textcoords="offset points", ha="center", fontsize=8)
    ax.set_yscale("log")
    ax.set_ylim(min(0.5, 0.5 * min(ratios)), 6.0 * max(ratios))
    ax.set_ylabel("time of a warm run / that of the ideal joint [-]")
    ax.tick_params(axis="x", labelsize=9)
    ax.grid(False, axis="x")
    return figure
