"""A cycle: its motion, its multipliers, and what they say."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.jobs import statistics
from spherejax.motion.integration.problem import stages_of
from spherejax.motion.integration.spans import Jobs
from spherejax.motion.integration.status import SimulationError
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.assembly import Assembly
from spherejax.studies.cycles.family import Family
from spherejax.studies.cycles.shooting import CandidateState

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def margin(rtol: float) -> float:
    """Moduli of multipliers this near to 1 are 1: a double multiplier is split by the root of its error."""
    return 3 * rtol**0.5


@dataclass(frozen=True)
class Multipliers:
    """Floquet multipliers of a cycle: a small deviation becomes mu times itself in a period.

    Attributes:
        values: all of them, by size, the largest first, shape (k,).
        is_free: which of them is 1 because the cycle is its own time's master: a shift in time lasts. None of a driven
            mechanism.
        margin: moduli this near to 1 count as 1.
        doubt: estimated error of the matrix whose eigenvalues they are, where it was found from disturbed starts; 0
            where it was integrated beside the motion.
    """

    values: Complex[np.ndarray, " k"]
    is_free: np.ndarray
    margin: float
    doubt: float = 0.0

    @classmethod
    def of(cls, monodromy: Float[np.ndarray, "k k"], is_driven: bool, rtol: float, doubt: float = 0.0) -> "Multipliers":
        """Those of a monodromy matrix, and by how much it may be wrong."""
        values = np.asarray(np.linalg.eigvals(monodromy), complex)
        values = values[np.lexsort((-np.imag(values), -np.abs(values)))]
        is_free = np.zeros(len(values), bool)
        if not is_driven and len(values):
            is_free[np.argmin(np.abs(values - 1))] = True
        return cls(values, is_free, margin(max(rtol, doubt)), doubt)

    @property
    def judged(self) -> Complex[np.ndarray, " k"]:
        """Those that say something of the stability."""
        return self.values[~self.is_free]

    @property
    def largest(self) -> float:
        """Modulus of the largest; 0 of a mechanism without freedom."""
        return float(np.abs(self.judged).max(initial=0.0))

    @property
    def is_stable(self) -> bool:
        """Whether no deviation grows."""
        return self.largest <= 1 + self.margin

    @property
    def n_unstable(self) -> int:
        """How many directions grow."""
        return int(np.sum(np.abs(self.judged) > 1 + self.margin))

    @property
    def words(self) -> str:
        """What they say of the stability."""
        mu = self.largest
        if self.judged.size == 0:
            return "stable: nothing is free to deviate"
        if mu < 1 - self.margin:
            return f"stable: the slowest deviation shrinks to {mu:.4g} of itself in a period"
        if self.is_stable:
            return "neutral: some deviation neither grows nor dies"
        worst = self.judged[np.argmax(np.abs(self.judged))]
        how = "swings around the cycle as it grows"
        if abs(worst.imag) <= 1e-9 * abs(worst):
            how = "grows to one side" if worst.real > 0 else "grows, from side to side in turn (period doubling)"
        return f"unstable: a deviation {how}, {mu:.4g} times in a period"


@dataclass(frozen=True, repr=False)
class Cycle:
    """A motion that repeats itself; prints what it is.

    Attributes:
        run: one period of it, at instants of equal distance, both ends among them.
        period: [s].
        multipliers: of its stability.
        succeeded: whether it closes.
        diagnosis: why not, and what to do; empty where it does.
        error: by how much the state after a period differs from the first, as a share of the size of the cycle.
        n_steps: Newton steps.
        is_driven: whether the period was given.
        values: numbers of the scene that was asked for, by name.
    """

    run: Trajectory
    period: float
    multipliers: Multipliers
    succeeded: bool
    diagnosis: str
    error: float
    n_steps: int
    is_driven: bool
    values: dict[str, float] = field(default_factory=dict)

    @property
    def is_stable(self) -> bool:
        """Whether no small deviation from it grows."""
        return self.succeeded and self.multipliers.is_stable

    @property
    def frequency(self) -> float:
        """[Hz]."""
        return 1 / self.period

    def require_success(self) -> "Cycle":
        """The cycle itself; raises `SimulationError` with the diagnosis where there is none."""
        if not self.succeeded:
            raise SimulationError(self.diagnosis)
        return self

    def harmonics(self, name: str, n: int = 20) -> "xarray.DataArray":
        """Complex amplitudes of a quantity: y = Re(sum over k of c_k exp(2 pi i k (t - t0) / T)), t0 its first instant.

        Args:
            name: of a number, e.g. `"position.rocker.z"`, `"shock.length"`.
            n: harmonics; the mean is that of order 0.

        Raises:
            SceneError: for a vector, a name that is none, or more harmonics than the samples can tell apart.
        """
        import xarray

        found = quantity(name, self.run.system)
        values = np.asarray(found.of(self.run))
        if values.ndim != 1:
            raise SceneError(f"harmonics of {name!r}: name one component, e.g. {name + '.z'!r}")
        most = (len(values) - 1) // 2 - 1
        if not 0 < n <= most:
            raise SceneError(f"harmonics: n = {n} must be from 1 to {most}, what {len(values)} samples can tell apart")
        c = coefficients(values)[: n + 1]
        return xarray.DataArray(
            c, {"order": np.arange(n + 1)}, ("order",), name, {"units": found.unit, "period": self.period}
        )

    def to_xarray(self) -> "xarray.Dataset":
        """The motion as a table, with period, multipliers and what they say."""
        found = self.run.to_xarray()
        mu = self.multipliers.values
        found["multiplier_real"] = ("multiplier", np.real(mu))
        found["multiplier_imag"] = ("multiplier", np.imag(mu))
        return found.assign_attrs(
            period=self.period, stability=self.multipliers.words, stable=int(self.is_stable), closing_error=self.error
        )

    def figure(self, *names: str) -> "Figure":
        """Quantities over a period, their orbits, and the multipliers in the unit circle; see `sj.plot.cycle`."""
        from spherejax.output.plot.cycles import cycle

        return cycle(self, names)

    def __str__(self) -> str:
        if not self.succeeded:
            return f"no cycle: {self.diagnosis}"
        shown = ", ".join(_complex(mu) for mu in self.multipliers.values[:6])
        more = len(self.multipliers.values) - 6
        shown += f" and {more} smaller ones" if more > 0 else ""
        what = "driven" if self.is_driven else "free"
        values = "".join(f", {name} = {value:.6g}" for name, value in self.values.items())
        doubt = self.multipliers.doubt
        by = f"; from disturbed starts, their matrix good to {doubt:.1e}" if doubt else ""
        return "\n".join(
            [
                f"Cycle of {self.period:.9g} s ({self.frequency:.6g} Hz), {what}{values}",
                self.multipliers.words,
                f"multipliers: {shown or 'none'}{by}",
                f"closes to {self.error:.1e} of its size after {self.n_steps} Newton steps",
            ]
        )

    __repr__ = __str__


def coefficients(values: Float[np.ndarray, "n *k"]) -> Complex[np.ndarray, "h *k"]:
    """Complex amplitudes of harmonics from samples over a period, both ends among them; the mean first."""
    n = len(values) - 1
    c = np.fft.rfft(values[:-1], axis=0) / n
    c[1:] *= 2
    return c


def _complex(value: complex) -> str:
    if abs(value.imag) <= 1e-9 * max(abs(value), 1e-12):
        return f"{value.real:.4g}"
    return f"{value.real:.4g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.4g}i"


def motions(family: Family, places: CandidateState, begin: float, samples: int) -> list[Trajectory]:
    """One period from each state, as runs."""
    n = len(places.y)
    theta = family.theta(places.values)
    y0 = np.array(places.y)
    y0[:, family.layout.work_start :] = 0.0
    wanted = np.all(np.isfinite(theta), axis=1) & np.all(np.isfinite(y0), axis=1)
    theta = np.where(np.isfinite(theta), theta, 1.0)
    jobs = Jobs(theta, y0, np.zeros((n, 0, theta.shape[1])), np.full(n, begin), np.asarray(places.period), wanted)
    shares = np.linspace(0.0, 1.0, samples + 1)
    found = family.flown(jobs, shares, with_rows=False)
    explanation = f"{family.choice.reason}; {family.tolerances.description}"
    runs = []
    for k in range(n):
        one: Any = type(found)(*(each if np.ndim(each) == 0 else each[k] for each in found))
        start = y0[k, : family.layout.memory_start]
        none = np.zeros(family.layout.n_bodies)
        runs.append(
            Trajectory(
                ts=jnp.asarray(begin + shares * places.period[k]),
                ys=jnp.asarray(one.ys),
                system=family.system(theta[k]),
                stats=statistics(one, stages_of(family.choice.solver), explanation),
                ended=jnp.asarray(one.status),
                t_reached=jnp.asarray(begin + one.t_reached * places.period[k]),
                y_reached=jnp.asarray(one.y_reached),
                assembly=Assembly(*map(jnp.asarray, (start, 0.0, 0.0, none, none, none))),
                choice=family.choice.reason,
                scalar=family.scalar,
                settings=family.settings,
            )
        )
    return runs
