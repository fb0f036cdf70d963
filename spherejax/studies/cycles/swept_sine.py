"""`sj.studies.swept_sine`: the frequency response of the mechanism itself, not of its linear neighbor."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import diffrax
import numpy as np
from jaxtyping import Bool, Complex, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible, whole_number
from spherejax.foundations.terminals import waiting_for
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.equilibrium import equilibrium
from spherejax.motion.start.start_now import start_now
from spherejax.studies.cycles.cycle_result import Multipliers, coefficients, motions
from spherejax.studies.cycles.family import Family
from spherejax.studies.cycles.shaking import shaken
from spherejax.studies.cycles.shooting import CandidateState, SearchOutcome, Shooting, search, settled, stacked_places
from spherejax.studies.cycles.study import TOLERANCE, CycleWarning
from spherejax.studies.linear import Linearization, linearize

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SETTLE = 20
"""Periods that are simulated before a cycle is looked for, so that it is one on which the motion settles."""

UNRESOLVED = 1e-2
"""Share of the harmonics that may lie in the upper half of what the samples can tell apart."""


@dataclass(frozen=True, repr=False)
class SweptSine:
    """Steady answers to a harmonic input, by amplitude and frequency; prints as a table.

    Attributes:
        input: path of the number that is shaken.
        outputs: names of the quantities.
        output_units: their units.
        amplitudes: of the input, shape (a,).
        frequencies: [Hz], shape (f,).
        response: first harmonic of each output over the input, complex, shape (a, f, o); NaN where no cycle was found.
        mean: of each output, shape (a, f, o).
        distortion: share of the higher harmonics, sqrt(sum of squares of 2nd, 3rd, ...) over the first, shape (a, f,
            o).
        peak: largest departure from the mean, shape (a, f, o).
        is_stable: whether the cycle lasts, shape (a, f).
        succeeded: whether one was found, shape (a, f).
        error: by how much each closes, as a share of its size, shape (a, f).
        linear: the linearization about the rest beside which it is to be seen.
        notes: what a reader must know.
    """

    input: str
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    amplitudes: Float[np.ndarray, " a"]
    frequencies: Float[np.ndarray, " f"]
    response: Complex[np.ndarray, "a f o"]
    mean: Float[np.ndarray, "a f o"]
    distortion: Float[np.ndarray, "a f o"]
    peak: Float[np.ndarray, "a f o"]
    is_stable: Bool[np.ndarray, "a f"]
    succeeded: Bool[np.ndarray, "a f"]
    error: Float[np.ndarray, "a f"]
    linear: Linearization = field(repr=False)
    notes: list[str]

    @property
    def linear_response(self) -> "xarray.DataArray":
        """What the linearization answers at the same frequencies, over frequency, output and input."""
        return self.linear.frequency_response(self.frequencies)

    @property
    def departure(self) -> Float[np.ndarray, "a f o"]:
        """|response - linear response| as a share of the largest linear response of the output in the sweep."""
        linear = np.asarray(self.linear_response)[:, :, 0]
        return np.abs(self.response - linear) / np.abs(linear).max(axis=0)

    def to_xarray(self) -> "xarray.Dataset":
        """The answers over amplitude, frequency and output, with those of the linearization; complex in two parts."""
        import xarray

        linear = np.asarray(self.linear_response)[:, :, 0]
        over, here = ("amplitude", "frequency", "output"), ("amplitude", "frequency")
        return xarray.Dataset(
            {
                "response_real": (over, np.real(self.response)),
                "response_imag": (over, np.imag(self.response)),
                "mean": (over, self.mean),
                "peak": (over, self.peak),
                "distortion": (over, self.distortion, {"units": "1"}),
                "stable": (here, self.is_stable.astype(int)),
                "closing_error": (here, self.error),
                "linear_real": (over[1:], np.real(linear)),
                "linear_imag": (over[1:], np.imag(linear)),
            },
            {
                "amplitude": self.amplitudes,
                "frequency": ("frequency", self.frequencies, {"units": "Hz"}),
                "output": list(self.outputs),
            },
            {"input": self.input, "output_units": ", ".join(self.output_units), "notes": "; ".join(self.notes)},
        )

    def figure(self, output: str | None = None) -> "Figure":
        """Magnitude, phase and distortion over frequency, the linear response as a line; see `sj.plot.swept_sine`."""
        from spherejax.output.plot.cycles import swept_sine as drawn

        return drawn(self, output)

    def __str__(self) -> str:
        a, f = self.succeeded.shape
        lines = [
            f"Swept sine of {self.input}: {f} frequencies from {self.frequencies.min():.6g} to "
            f"{self.frequencies.max():.6g} Hz, {a} amplitudes; {int(self.succeeded.sum())} of {a * f} cycles found"
        ]
        for i, output in enumerate(self.outputs):
            lines.append(f"{output}: largest answers over the input, their frequencies, and distortion there")
            for k, amplitude in enumerate(self.amplitudes):
                sizes = np.where(self.succeeded[k], np.abs(self.response[k, :, i]), -1.0)
                j = int(np.argmax(sizes))
                if sizes[j] < 0:
                    lines.append(f"  amplitude {amplitude:.4g}: no cycle")
                    continue
                lines.append(
                    f"  amplitude {amplitude:.4g}: {sizes[j]:.6g} at {self.frequencies[j]:.6g} Hz, "
                    f"{100 * self.distortion[k, j, i]:.3g} %; from the linear response by up to "
                    f"{100 * np.nanmax(self.departure[k, :, i]):.3g} % of its largest"
                )
        return "\n".join([*lines, *self.notes])

    __repr__ = __str__


def swept_sine(
    scene: Scene,
    input: str,
    outputs: Sequence[str] | str,
    frequencies: Any,
    amplitudes: Any,
    *,
    at: str = "rest",
    sweep: Literal["up", "down"] | None = None,
    settle: int = SETTLE,
    samples: int = 128,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
) -> SweptSine:
    """The steady answer of a mechanism to a harmonic input, frequency by frequency, with all its nonlinearity.

        input(t) = value + amplitude sin(2 pi frequency t)

    Every frequency and amplitude is a run of its own, all at once in lanes: some periods are simulated, and the cycle
    on which they settle is then found by shooting, to the tolerance, however lightly damped; that it closes is tested,
    and where it does not the answer is NaN, with a warning. Beside it stands the linear response about the rest
    (`sj.linearize`), to which small amplitudes tend.

    Args:
        scene: the mechanism.
        input: path of a component of an applied force or moment, `"forces.push.force.z"`, or of gravity, `"gravity.z"`
            (a shaken foundation).
        outputs: quantities, one component each, e.g. `"position.rocker.z"`, `"shock.length"`.
        frequencies: [Hz].
        amplitudes: of the input, one or several, in its unit.

    Other args:
        at: where the runs begin, and about what the linear response is: "rest" or "start".
        sweep: "up" or "down": each frequency begins where the one before has settled, as on a test bench, so that jumps
            and hysteresis show; None: each begins at rest.
        settle: periods that are simulated before a cycle is looked for.
        samples: instants of a period, by which harmonics are told apart.
        rtol, solver, max_steps: as in `simulate`; explicit and Rosenbrock methods.

    Returns:
        Response, mean, distortion and stability: `.to_xarray()`, `.figure()`, `.departure`; prints as a table.

    Raises:
        SceneError: for a request that makes no sense.

    Warns:
        CycleWarning: where no cycle was found, or the samples are too few for its harmonics.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"swept_sine: {type(scene).__name__} is no scene")
    if at not in ("rest", "start"):
        raise SceneError(f"swept_sine: at={at!r}: it is 'rest' or 'start'")
    if sweep not in (None, "up", "down"):
        raise SceneError(f"swept_sine: sweep={sweep!r}: it is 'up', 'down', or None for runs that each begin at rest")
    f, a = _positive("frequencies", frequencies), _positive("amplitudes", amplitudes)
    settle = whole_number("settle", settle, f"Leave it out for {SETTLE}.")
    samples = whole_number("samples", samples, "Leave it out for 128.")
    if samples < 16:
        raise SceneError(f"swept_sine: samples = {samples} tell too few harmonics apart; take 16 or more")
    build = shaken(scene, input)
    with waiting_for("cycles", program="over_spans"):
        linear = linearize(scene, at=at, inputs=input, outputs=outputs)
        _require_components(linear)
        family = Family(build, {"amplitude": a[0], "frequency": f[0]}, rtol=rtol, solver=solver, max_steps=max_steps)
        start = _start(scene, input, at, a[0], f[0])
        found = _cycles(family, start, f, a, sweep, settle)
        return _answers(family, found, linear, f, a, samples)


def _positive(name: str, given: Any) -> np.ndarray:
    try:
        values = np.atleast_1d(np.asarray(visible(given), np.float64))
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if values.ndim != 1 or not values.size or not np.all(np.isfinite(values) & (values > 0)):
        raise SceneError(f"swept_sine: {name} = {given!r} must be positive numbers")
    if np.unique(values).size != values.size:
        raise SceneError(f"swept_sine: {name} holds a value twice")
    return np.sort(values)


def _require_components(linear: Linearization) -> None:
    if len(linear.inputs) != 1:
        raise SceneError(f"swept_sine: the input is {len(linear.inputs)} numbers; name one, e.g. {linear.inputs[0]!r}")
    if not linear.outputs:
        raise SceneError('swept_sine: outputs= names no quantity; give e.g. ["position.rocker.z"]')


def _start(scene: Scene, input: str, at: str, amplitude: float, frequency: float) -> np.ndarray:
    whole = equilibrium(scene).scene if at == "rest" else scene
    system = compile_scene(shaken(whole, input)(amplitude, frequency)).system
    assembly = start_now(system, np.array([0.0, 1.0 / frequency]), stacklevel=4)
    assert assembly is not None
    return np.asarray(initial_state(system, assembly))


def _cycles(family: Family, start: np.ndarray, f, a, sweep, settle: int) -> list[SearchOutcome]:
    """What was found, by amplitude and frequency in turn."""
    shooting = Shooting(family, 0.0)
    tolerance = TOLERANCE * family.rtol

    def found_from(y: np.ndarray, pairs: list[tuple[float, float]]) -> list[SearchOutcome]:
        values = np.array(pairs)
        places = CandidateState(y, 1 / values[:, 1], values)
        if settle:
            ends, _ = settled(family, places, 0.0, settle)
            places = places._replace(y=ends)
        return search(shooting, places, tolerance=tolerance)

    if sweep is None:
        pairs = [(amplitude, frequency) for amplitude in a for frequency in f]
        return found_from(np.repeat(start[None], len(pairs), 0), pairs)
    order = range(len(f)) if sweep == "up" else range(len(f) - 1, -1, -1)
    y = np.repeat(start[None], len(a), 0)
    columns: dict[int, list[SearchOutcome]] = {}
    for j in order:
        columns[j] = found_from(y, [(amplitude, f[j]) for amplitude in a])
        y = np.stack([one.shot.place.y if one.is_cycle else y[k] for k, one in enumerate(columns[j])])
    return [columns[j][k] for k in range(len(a)) for j in range(len(f))]


def _answers(family: Family, found: list[SearchOutcome], linear: Linearization, f, a, samples: int) -> SweptSine:
    shape = len(a), len(f)
    runs = motions(family, stacked_places([one.shot.place for one in found]), 0.0, samples)
    asked = [quantity(name, family.example) for name in linear.outputs]
    good = np.array([one.is_cycle for one in found])
    values = np.stack([np.stack([np.asarray(each.of(run)) for each in asked], -1) for run in runs], 1)
    c = np.where(good[None, :, None], coefficients(values), np.nan)
    inputs = -1j * np.repeat(a, len(f))[:, None]
    first, size = c[1], np.linalg.norm(c[1:], axis=0)
    higher, upper = np.linalg.norm(c[2:], axis=0), np.linalg.norm(c[len(c) // 2 :], axis=0)
    multipliers = [Multipliers.of(one.shot.monodromy, True, family.rtol, one.shot.doubt) for one in found]
    notes = _notes(found, linear, upper, size, multipliers, f, a)
    return SweptSine(
        input=linear.inputs[0],
        outputs=linear.outputs,
        output_units=linear.output_units,
        amplitudes=a,
        frequencies=f,
        response=(first / inputs).reshape(*shape, -1),
        mean=c[0].real.reshape(*shape, -1),
        distortion=np.divide(higher, np.abs(first), out=np.full(higher.shape, np.nan), where=np.abs(first) > 0).reshape(
            *shape, -1
        ),
        peak=np.abs(values - c[0].real).max(axis=0).reshape(*shape, -1),
        is_stable=np.array([each.is_stable for each in multipliers]).reshape(shape) & good.reshape(shape),
        succeeded=good.reshape(shape),
        error=np.array([one.shot.error for one in found]).reshape(shape),
        linear=linear,
        notes=notes,
    )


def _notes(found: list[SearchOutcome], linear: Linearization, upper, size, multipliers, f, a) -> list[str]:
    pairs = [(amplitude, frequency) for amplitude in a for frequency in f]
    notes = []
    missing = [k for k, one in enumerate(found) if not one.is_cycle]
    if missing:
        amplitude, frequency = pairs[missing[0]]
        notes.append(
            f"{len(missing)} of {len(found)} cycles were not found, the first at {frequency:.6g} Hz with an amplitude "
            f"of {amplitude:.4g}: {found[missing[0]].why}"
        )
    coarse = np.nan_to_num(upper) > UNRESOLVED * np.nan_to_num(size)
    if np.any(coarse):
        k, i = np.argwhere(coarse)[0]
        notes.append(
            f"{linear.outputs[i]} at {pairs[k][1]:.6g} Hz with an amplitude of {pairs[k][0]:.4g} has harmonics that "
            "the samples do not tell apart; give samples= more"
        )
    if notes:
        warnings.warn("swept_sine: " + " ".join(notes), CycleWarning, stacklevel=4)
    lost = sum(one.is_cycle and not each.is_stable for one, each in zip(found, multipliers, strict=True))
    if lost:
        notes.append(f"{lost} of the cycles are unstable: the motion does not stay on them")
    return notes
