"""Histories of one run: where the bodies are and how fast, what the joints carry, where the energy is."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.curves import curves_of, thinned
from spherejax.output.plot.eccentricity import eccentricity_paths
from spherejax.output.plot.magnified import MOST_PANELS
from spherejax.output.plot.space import BODY_COLORS, unit_for
from spherejax.output.plot.style import (
    LABELS,
    legend_below,
    legend_under,
    letter,
    limit_by_bulk,
    new_figure,
    note,
    repeated,
)

MOST_CURVES = 8
"""Curves in a panel: as many as there are colors; of more bodies or joints the first are drawn, and it is said."""

Histories = Mapping[str, np.ndarray]


def figures_of_run(run: Trajectory) -> dict[str, Figure]:
    """Figures of a single run by what they show; without those of which there is nothing to show.

    Args:
        run: a single run on the host. Samples that a failed run did not reach are gaps.

    Returns:
        None of them for a run with fewer than two samples.
    """
    if int(np.isfinite(np.asarray(run.ys)).all(axis=1).sum()) < 2:
        return {}
    found = {"positions and speeds of the bodies": _bodies(run), "energies": _energies(run)}
    if run.system.joints:
        found["forces and moments of the joints"] = _joints(run)
    if run.system.force_joints:
        found["paths of the balls' centers in their sockets"] = _paths(run)
    return found


def _bodies(run: Trajectory) -> Figure:
    names = list(run.system.bodies)[:MOST_CURVES]
    positions = {name: np.asarray(run.position(name)) for name in names}
    size = max(float(np.nanmax(np.ptp(_finite(each), axis=0))) for each in positions.values())
    unit, factor = unit_for(size)
    figure, axes = new_figure(2, 3, 11.0, 5.6, "Centers of mass")
    for i, letter_of in enumerate("xyz"):
        _panel(axes[0, i], run, {name: factor * at[:, i] for name, at in positions.items()}, f"{letter_of} [{unit}]")
    panels = (
        (axes[1, 0], run.velocity, "speed [m/s]"),
        (axes[1, 1], run.acceleration, "acceleration, magnitude [m/s$^2$]"),
        (axes[1, 2], run.angular_velocity, "angular speed [rad/s]"),
    )
    for ax, observed, label in panels:
        _panel(ax, run, _magnitudes(observed, names), label, bulk=True)
    return _finished(figure, axes, len(run.system.bodies))


def _joints(run: Trajectory) -> Figure:
    names = list(run.system.joints)[:MOST_CURVES]
    figure, axes = new_figure(1, 2, 9.0, 3.4, "What joints exert on their second bodies")
    _panel(axes[0, 0], run, _magnitudes(run.reaction, names), "force, magnitude [N]", bulk=True)
    _panel(axes[0, 1], run, _magnitudes(run.reaction_moment, names), "moment, magnitude [N m]", bulk=True)
    return _finished(figure, axes, len(run.system.joints))


def _energies(run: Trajectory) -> Figure:
    kinds = {
        "kinetic": np.asarray(run.kinetic_energy),
        "potential": _change(run.potential_energy),
        "elastic": np.asarray(run.elastic_energy),
    }
    balance = {"mechanical": _change(run.mechanical_energy)}
    if run.system.tracks_supply:
        balance["put in by drivers and forces"] = np.asarray(run.supplied_work)
    figure, axes = new_figure(1, 2, 9.0, 3.4, "Energies; potential and mechanical against the first sample")
    _panel(axes[0, 0], run, kinds, "energy [J]")
    _panel(axes[0, 1], run, balance, "change [J]")
    for ax in axes.flat:
        legend_under(ax, n_columns=3)
    letter(list(axes.flat))
    return figure


def _paths(run: Trajectory) -> Figure:
    body = next(iter(run.system.bodies))
    able = [name for name in run.system.force_joints if name in run.observation.eccentricity]
    curves = {name: curves_of(run, name, body=body, joint=name, axis="z") for name in able[:MOST_PANELS]}
    return eccentricity_paths(curves, "Center of the ball in its socket")


def _panel(ax: Axes, run: Trajectory, curves: Histories, label: str, *, bulk: bool = False) -> None:
    ts = np.asarray(run.ts)
    for color, (name, values) in zip(repeated(BODY_COLORS, len(curves)), curves.items(), strict=True):
        ax.plot(*thinned(ts, values), color=color, lw=1.0, label=name)
    ax.set_xlabel(LABELS["t"])
    ax.set_ylabel(label)
    ax.set_xlim(ts[0], ts[-1])
    if bulk:
        limit_by_bulk(ax, list(curves.values()), keep=99.0)


def _finished(figure: Figure, axes: np.ndarray, n: int) -> Figure:
    if n > MOST_CURVES:
        note(axes.flat[0], f"the first {MOST_CURVES} of {n}", place=(0.99, 0.98))
    letter(list(axes.flat))
    legend_below(figure, axes.flat[0])
    return figure


def _magnitudes(observed: Callable, names: Sequence[str]) -> dict[str, np.ndarray]:
    return {name: np.linalg.norm(np.asarray(observed(name)), axis=1) for name in names}


def _change(values) -> np.ndarray:
    values = np.asarray(values)
    return values - values[0]


def _finite(rows: np.ndarray) -> np.ndarray:
    return rows[np.isfinite(rows).all(axis=1)]
