"""Figures of results: `sj.plot.four_histories(...)` and others, and the look that they share.

Each function returns a matplotlib figure, which a notebook shows as it is and `figure.savefig(path)` writes. Figures
of a whole study come from its result: `fitted.figures()`, `study.figures(...)`; pictures of a mechanism from `sj.draw`.

    curves = {name: sj.plot.curves_of(run, name, body="rocker", joint="coupler_rocker") for name, run in runs.items()}
    sj.plot.eccentricity_paths(curves, "Center of the ball in the socket")

histories of runs           `curves_of` for `four_histories`, `phase_portraits`, `eccentricity_paths`
                            `Panel` for `model_histories`; `spectrum`
energy of a run by part     `energy_by_part`
force laws by themselves    `impact_loops`, `friction_curves`, `hybrid_force`, `dynamic_stiffness`
linearizations              `bode`, `modes`
suspension rigs             `rig`
cycles                      `cycle`, `continuation`, `swept_sine`
sweeps                      `figures_of_sweep`
figures of your own         `new_figure`, `letter`, `ordered_colors`, `MODEL_COLORS`, `LAW_COLORS`, `LAW_DASHES`

Matplotlib is imported with this module, and this module when `sj.plot` is first used.
"""

from spherejax.output.plot.bode import bode
from spherejax.output.plot.curves import Curves, curves_of
from spherejax.output.plot.cycles import continuation, cycle, swept_sine
from spherejax.output.plot.eccentricity import eccentricity_paths
from spherejax.output.plot.energy_parts import energy_by_part
from spherejax.output.plot.histories import four_histories
from spherejax.output.plot.laws import friction_curves, hybrid_force, impact_loops
from spherejax.output.plot.modes import modes
from spherejax.output.plot.panels import Panel, Shade, model_histories
from spherejax.output.plot.phase import phase_portraits
from spherejax.output.plot.rig import rig
from spherejax.output.plot.spectra import spectrum
from spherejax.output.plot.stiffness import dynamic_stiffness
from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, MODEL_COLORS, letter, new_figure, ordered_colors
from spherejax.output.plot.swept import figures_of_sweep

__all__ = [
    "LAW_COLORS",
    "LAW_DASHES",
    "MODEL_COLORS",
    "Curves",
    "Panel",
    "Shade",
    "bode",
    "continuation",
    "curves_of",
    "cycle",
    "dynamic_stiffness",
    "eccentricity_paths",
    "energy_by_part",
    "figures_of_sweep",
    "four_histories",
    "friction_curves",
    "hybrid_force",
    "impact_loops",
    "letter",
    "model_histories",
    "modes",
    "new_figure",
    "ordered_colors",
    "phase_portraits",
    "rig",
    "spectrum",
    "swept_sine",
]
