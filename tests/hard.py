"""Small scenes with traced numbers, so that one compiled program serves many hard cases; and what all must obey."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj

N_SAMPLES = 11
FINAL = (slice(0, 3), slice(7, 10))  # position and velocity of the ball in the flat state

BALL = {
    "mass": 0.2,
    "inertia": 1e-5,
    "gravity": 9.81,
    "x": 0.0,
    "z": 0.0,
    "vx": 0.0,
    "vz": 0.0,
    "spin": 0.0,
}
"""A ball, at the center of its socket, that weight will press downwards."""


class Outcome(NamedTuple):
    """Of one run, as NumPy arrays."""

    ys: Any
    status: Any
    t_reached: Any
    n_accepted: Any
    n_onsets: Any
    energy: Any
    kinetic: Any
    eccentricity: Any

    @property
    def position(self):
        return self.ys[:, :3]

    @property
    def velocity(self):
        return self.ys[:, 7:10]


@dataclass(frozen=True)
class Family:
    """Balls in sockets that differ in numbers only.

    Attributes:
        model: the joint's model from the numbers.
        numbers: the model's own numbers.
        max_steps: bound on the steps of every run: none may hang.
        solver: None for the automatic choice.
    """

    model: Callable
    numbers: tuple
    max_steps: int = 400_000
    solver: Any = None

    def all_numbers(self, changes) -> dict[str, float]:
        return {**BALL, **dict(self.numbers), **changes}

    def scene(self, numbers) -> sj.Scene:
        def vector(x, y, z):
            return jnp.stack([jnp.asarray(v, jnp.float64) for v in (x, y, z)])

        ball = sj.Body(
            numbers["mass"],
            numbers["inertia"] * jnp.ones(3),
            position=vector(numbers["x"], 0.0, numbers["z"]),
            velocity=vector(numbers["vx"], 0.0, numbers["vz"]),
            angular_velocity=vector(0.0, numbers["spin"], 0.0),
            points={"center": (0.0, 0.0, 0.0)},
        )
        joint = sj.Spherical("ground.socket", "ball.center", self.model(numbers), starts_concentric=False)
        return sj.Scene(
            {"ball": ball},
            {"joint": joint},
            gravity=vector(0.0, 0.0, -numbers["gravity"]),
            ground_points={"socket": (0.0, 0.0, 0.0)},
        )

    def simulate(self, numbers, ts, rtol) -> sj.Trajectory:
        # Positions are some micrometers, velocities some mm/s: the absolute tolerance is a thousandth.
        return sj.simulate(
            self.scene(numbers), ts, rtol=rtol, atol=1e-3 * rtol, max_steps=self.max_steps, solver=self.solver
        )


@cache
def _values(family: Family):
    def outcome(numbers, ts, rtol):
        run = family.simulate(numbers, ts, rtol)
        return Outcome(
            run.ys,
            run.status,
            run.t_reached,
            run.stats.n_accepted,
            run.stats.n_onsets,
            run.mechanical_energy,
            run.kinetic_energy,
            jnp.linalg.norm(run.position("ball"), axis=1),
        )

    return jax.jit(outcome)


@cache
def _slopes(family: Family, names: tuple[str, ...]):
    def final(x, numbers, ts, rtol):
        moved = {**numbers, **{name: numbers[name] * (1 + x[i]) for i, name in enumerate(names)}}
        y = family.simulate(moved, ts, rtol).ys[-1]
        return jnp.stack([y[part] for part in FINAL])

    return jax.jit(jax.jacfwd(final))


def times(t_end: float, t_start: float = 0.0):
    return t_start + jnp.linspace(0.0, t_end, N_SAMPLES)


def run(family: Family, t_end: float, *, rtol: float = 1e-8, t_start: float = 0.0, **changes) -> Outcome:
    numbers = {name: jnp.asarray(float(value)) for name, value in family.all_numbers(changes).items()}
    found = _values(family)(numbers, times(t_end, t_start), jnp.asarray(rtol))
    return Outcome(*map(np.asarray, found))


def gradient(family: Family, names, t_end: float, *, rtol: float = 1e-10, t_start: float = 0.0, **changes):
    """Final position [m] and velocity [m/s] by the relative change of each number: shape (2, 3, n)."""
    numbers = {name: jnp.asarray(float(value)) for name, value in family.all_numbers(changes).items()}
    found = _slopes(family, tuple(names))(jnp.zeros(len(names)), numbers, times(t_end, t_start), jnp.asarray(rtol))
    return np.asarray(found)


def differences(family: Family, names, t_end: float, *, rtol: float = 1e-12, step: float = 1e-6, **changes):
    """What `gradient` finds, by central differences of tight runs."""
    numbers = family.all_numbers(changes)
    columns = []
    for name in names:
        ends = [
            run(family, t_end, rtol=rtol, **{**changes, name: numbers[name] * (1 + h)}).ys[-1] for h in (step, -step)
        ]
        columns.append(np.stack([(ends[0] - ends[1])[part] / (2 * step) for part in FINAL]))
    return np.stack(columns, -1)


def disagreement(found, expected) -> float:
    """Largest difference, of positions and of velocities relative to the largest entry of its kind."""
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    return float(np.max(np.abs(found - expected) / np.where(scale > 0, scale, 1.0)))


def created_energy(found: Outcome) -> float:
    """The most that the energy ever exceeds its start [J]; the joints of the hard cases only take."""
    return float(np.max(found.energy - found.energy[0]))


def energy_bound(found: Outcome, rtol: float) -> float:
    """Energy that errors can create [J].

    The root mean square over the 13 entries of the state is held below rtol, so one entry may be wrong by 4 rtol, and
    an energy, being a square, by 8 rtol. Errors of steps add at worst: 8 rtol times the energy in motion for every
    accepted step. Samples between steps lie on an interpolant that may be wrong by some ten times a step.
    """
    in_motion = max(float(np.ptp(found.energy)), float(np.max(found.kinetic)), float(np.abs(found.energy[0])))
    return 8 * rtol * (int(found.n_accepted) + 10) * in_motion


def assert_sound(found: Outcome, rtol: float = 1e-8) -> None:
    """Finished, finite, and no energy created."""
    assert found.status == sj.Status.SUCCEEDED, sj.Status(int(found.status))
    assert np.isfinite(found.ys).all()
    assert created_energy(found) <= energy_bound(found, rtol)


def assert_sound_or_diagnosed(found: Outcome, rtol: float = 1e-8) -> None:
    """Sound, or a status that says why not, with NaN only where the run did not come."""
    if found.status == sj.Status.SUCCEEDED:
        assert_sound(found, rtol)
        return
    assert sj.Status(int(found.status)) in (sj.Status.TOO_MANY_STEPS, sj.Status.STEP_TOO_SMALL)
    assert np.isfinite(found.ys[0]).all()
    assert np.isfinite(found.t_reached)
    reached = np.isfinite(found.ys).all(1)
    assert (np.diff(reached.astype(int)) <= 0).all()  # once stopped, nothing more
