"""What of a run is compared: histories at the samples, their errors, and statistics where histories do not repeat."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.motion.results.trajectory import Trajectory

UNITS: Mapping[str, str] = {
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "reaction": "N",
    "energy": "J",
}
"""The quantities whose errors are measured, with their units."""

STATISTICS: Mapping[str, tuple[str, str]] = {
    "peak_acceleration": ("m/s^2", "largest acceleration of a center of mass at the samples"),
    "dissipated_energy": ("J", "energy that the joints dissipate"),
    "time_in_contact": ("s", "time in which ball and socket touch, summed over joints"),
    "n_onsets": ("1", "contact onsets of the whole run"),
    "eccentricity_05": ("m", "|e|, exceeded in 95 % of the time"),
    "eccentricity_50": ("m", "|e|, exceeded half of the time"),
    "eccentricity_95": ("m", "|e|, exceeded in 5 % of the time"),
}
"""What is compared where a history is one of many, with unit and meaning: over the time after the runs have parted, but
for the onsets, which are counted over the whole run."""


class SampledRun(NamedTuple):
    """A run at its samples, as host arrays.

    Attributes:
        ts: sample times [s], shape (n,).
        vectors: position [m], velocity [m/s] and acceleration [m/s^2] of the centers of mass, shape (n, n_bodies, 3),
            and reaction forces of the joints [N], shape (n, n_joints, 3), by name.
        energy: kinetic and potential energy of the bodies and the work that the joints have absorbed [J], shape (n,);
            constant in an exact motion under weight alone.
        kinetic_energy: of all bodies [J], shape (n,).
        dissipated: energy that the joints have dissipated since the start [J], shape (n,).
        eccentricity: |e| of the joints with a clearance [m], shape (n, n_clearance_joints).
        is_touching: whether the ball touches, same shape.
        n_onsets: contact onsets of all joints.
    """

    ts: Float[np.ndarray, " n"]
    vectors: dict[str, np.ndarray]
    energy: Float[np.ndarray, " n"]
    kinetic_energy: Float[np.ndarray, " n"]
    dissipated: Float[np.ndarray, " n"]
    eccentricity: Float[np.ndarray, "n j"]
    is_touching: np.ndarray
    n_onsets: int

    @property
    def is_finite(self) -> bool:
        """Whether all histories are finite numbers."""
        return all(bool(np.all(np.isfinite(values))) for values in (*self.vectors.values(), self.energy))


def samples_of(run: Trajectory) -> SampledRun:
    """The histories of a run, integrated with `track_work=True` where joints answer with a force."""
    bodies, joints, ts = list(run.system.bodies), list(run.system.joints), np.asarray(run.ts)
    gaps = [name for name in run.system.force_joints if run.system.spherical(name).model.has_surfaces]
    work, dissipated = np.zeros(ts.shape), np.zeros(ts.shape)
    for name in run.system.resisting_joints:
        work = work + np.asarray(run.absorbed_work(name))
        dissipated = dissipated + np.asarray(run.dissipated_energy(name))
    vectors = {
        "position": np.stack([run.position(body) for body in bodies], 1),
        "velocity": np.stack([run.velocity(body) for body in bodies], 1),
        "acceleration": np.stack([run.acceleration(body) for body in bodies], 1),
        "reaction": np.stack([run.reaction(joint) for joint in joints], 1),
    }
    columns = [np.asarray(run.penetration(name)) for name in gaps]
    penetration = np.stack(columns, 1) if columns else np.zeros((len(ts), 0))
    clearances = np.array([float(run.clearance(name)) for name in gaps])
    kinetic = np.asarray(run.kinetic_energy)
    energy = kinetic + np.asarray(run.potential_energy) + work
    n_onsets = int(np.sum(run.stats.n_onsets))
    return SampledRun(ts, vectors, energy, kinetic, dissipated, penetration + clearances, penetration > 0, n_onsets)


def distances(one: SampledRun, other: SampledRun, quantity: str) -> Float[np.ndarray, " n"]:
    """Largest Euclidean distance over the bodies (reactions: joints) at each sample; of the energy, |difference|."""
    if quantity == "energy":
        return np.abs(one.energy - other.energy)
    apart = np.linalg.norm(one.vectors[quantity] - other.vectors[quantity], axis=2)
    return np.max(apart, axis=1, initial=0.0)


def errors(run: SampledRun, reference: SampledRun, until: float | None = None) -> dict[str, float]:
    """Largest distance over the samples, for each quantity, in its unit.

    Args:
        run: what is judged.
        reference: what it is judged against, at the same samples.
        until: last time that counts [s]; None for all.
    """
    counts = slice(None) if until is None else reference.ts <= until
    return {name: float(np.max(distances(run, reference, name)[counts])) for name in UNITS}


def scales(reference: SampledRun, until: float | None = None) -> dict[str, float]:
    """What errors are relative to: the peak of each quantity.

    The largest displacement from the start; the largest velocity, acceleration and reaction; the largest kinetic
    energy.
    """
    counts = slice(None) if until is None else reference.ts <= until
    vectors = {name: values[counts] for name, values in reference.vectors.items()}
    vectors["position"] = vectors["position"] - vectors["position"][:1]
    peaks = {name: float(np.max(np.linalg.norm(values, axis=2))) for name, values in vectors.items()}
    return {**peaks, "energy": float(np.max(reference.kinetic_energy[counts]))}


def statistics(run: SampledRun, since: float) -> dict[str, float]:
    """The entries of `STATISTICS` over the samples from a time [s] on; those of contact only where a gap exists."""
    counts = run.ts >= since
    size = np.linalg.norm(run.vectors["acceleration"][counts], axis=2)
    found = {
        "peak_acceleration": float(np.max(size)),
        "dissipated_energy": float(np.ptp(run.dissipated[counts][[0, -1]])),
    }
    if run.eccentricity.shape[1]:
        duration = float(run.ts[-1] - run.ts[counts][0])
        found["time_in_contact"] = duration * float(np.mean(run.is_touching[counts].sum(axis=1)))
        found["n_onsets"] = float(run.n_onsets)
        for percent in (5, 50, 95):
            found[f"eccentricity_{percent:02d}"] = float(np.percentile(run.eccentricity[counts], percent))
    return found
