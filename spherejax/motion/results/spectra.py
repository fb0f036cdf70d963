"""Spectra of what a run does, from its steps: no samples, and so nothing folds back from beyond half of their rate.

In each step a quantity is the cubic through its values at four Gauss nodes, c_k P_k(x) in Legendre's polynomials, and
each of them has its Fourier integral in closed form,

    int P_k(x) exp(-i a x) dx = 2 (-i)^k j_k(a)      over -1 <= x <= 1

with the spherical Bessel functions j_k: exact at any frequency, however long the step. An impact of microseconds is
told as it is, also where samples a millisecond apart would make a low tone of it.
"""

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import spherical_jn

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.motion.equations.quantities import quantity, value_at
from spherejax.motion.results.dataset import AXES
from spherejax.motion.results.steps import NODES, WEIGHTS, Steps, seen_at

if TYPE_CHECKING:
    import xarray

_ORDERS = range(len(NODES))
_TO_LEGENDRE = np.stack([(2 * k + 1) / 2 * WEIGHTS * np.polynomial.legendre.Legendre.basis(k)(NODES) for k in _ORDERS])
"""Coefficients c_k from the values at the nodes."""

USUAL_LINES = 400
"""Frequencies of a spectrum whose frequencies are not given: the first so many multiples of 1/T."""

UNRESOLVED = 0.05
"""Share of the cubic terms in what a quantity does within steps, from which a spectrum says that it is rough."""

AT_ONCE = 2**22
"""Steps times frequencies that are integrated together."""


class SpectrumWarning(UserWarning):
    """A spectrum of a quantity that the steps of the run do not resolve."""


def spectrum(
    system: System, steps: Steps, name: str, frequencies: Float[np.ndarray, " m"] | None, scalar: bool | None
) -> "xarray.Dataset":
    """Amplitudes and phases of a quantity by frequency.

    The steps of the run are integrated, not its samples: nothing is folded back from beyond half of a sampling rate, as
    tones of impacts would be. The mean is taken off, and Hann's window applied, so that a tone of the amplitude A shows
    A at its frequency, and half of that one line, 1/T, beside it.

    Args:
        system: what was run.
        steps: of the run, which is made once more for them, see `Trajectory.impacts`.
        name: of the quantity, as for `sj.sweep`; a vector has the dimension `axis`.
        frequencies: [Hz], shape (m,); None: the first 400 multiples of 1/T, with the length T of the run.
        scalar: whether the run was on scalar programs.

    Returns:
        `amplitude` and `phase` [rad] by `frequency`, the mean among the attributes.

    Raises:
        SceneError: for an unknown name or frequencies that are none.
    """
    import xarray

    what = quantity(name, system)
    if not steps.lengths.size:
        raise SceneError("a run of one instant has no spectrum")
    duration = float(steps.ends[-1]) - steps.t0
    asked = np.arange(1, USUAL_LINES + 1) / duration if frequencies is None else np.asarray(frequencies, float)
    if asked.ndim != 1 or not np.all(np.isfinite(asked) & (asked >= 0)):
        raise SceneError("frequencies of a spectrum must be numbers in a row, finite and not negative [Hz]")
    n, k = steps.inside.shape
    seen = seen_at(system, _value_of(name), steps.inside.ravel(), steps.at_inside.reshape(n * k, -1), scalar)
    values = np.asarray(seen).reshape(n, k, -1)  # components last
    _warn_where_rough(name, steps.lengths, values)
    mean = np.einsum("nkc,k,n->c", values, WEIGHTS / 2, steps.lengths) / duration
    lines = windowed(steps, values - mean, asked, duration)
    dims = ("frequency",) if np.ndim(seen) == 1 else ("frequency", "axis")
    shape = lines.shape if len(dims) == 2 else lines.shape[:1]
    unit = {"units": what.unit, "long_name": f"amplitude of {name}"}
    return xarray.Dataset(
        {
            "amplitude": (dims, np.abs(lines).reshape(shape), unit),
            "phase": (dims, np.angle(lines).reshape(shape), {"units": "rad", "long_name": "of the cosine at t = 0"}),
        },
        {
            "frequency": ("frequency", asked, {"units": "Hz"}),
            **({"axis": list(AXES)} if len(dims) == 2 and shape[1] == 3 else {}),
        },
        {
            "quantity": name,
            "mean": mean if len(dims) == 2 else float(mean[0]),
            "duration": duration,
            "window": "Hann",
        },
    )


def windowed(
    steps: Steps, values: Float[np.ndarray, "n k c"], frequencies: Float[np.ndarray, " m"], duration: float
) -> Array:
    """Complex amplitudes 2/int w int w(t) f(t) exp(-i omega t) dt under Hann's window, shape (m, c).

    The window w = (1 - cos(2 pi (t - t0)/T))/2 moves each line by one 1/T to either side: no sampling of it is needed.
    """
    beside = 1.0 / duration
    turn = np.exp(2j * np.pi * beside * steps.t0)  # of the window, that begins with the run
    middle = fourier(steps, values, frequencies)
    lower, upper = (fourier(steps, values, frequencies + side * beside) for side in (-1, 1))
    # w = 1/2 - exp(i W (t - t0))/4 - exp(-i W (t - t0))/4, and its integral is T/2.
    return 4.0 / duration * (middle / 2 - lower / turn / 4 - upper * turn / 4)


def fourier(steps: Steps, values: Float[np.ndarray, "n k c"], frequencies: Float[np.ndarray, " m"]) -> np.ndarray:
    """int f(t) exp(-2 pi i nu t) dt over all steps, shape (m, c)."""
    halves = steps.lengths / 2
    middles = steps.ends - halves
    coefficients = np.einsum("pk,nkc->npc", _TO_LEGENDRE, values)
    found = np.zeros((len(frequencies), values.shape[2]), complex)
    some = max(1, AT_ONCE // max(len(halves), 1))
    for start in range(0, len(frequencies), some):
        omega = 2 * np.pi * frequencies[start : start + some]
        angles = np.abs(omega)[:, None] * halves
        carrier = np.exp(-1j * omega[:, None] * middles) * halves
        sign = np.where(omega < 0, -1.0, 1.0)[:, None]
        for order in _ORDERS:
            # j_k has the parity of k.
            moments = 2 * (-1j * sign) ** order * spherical_jn(order, angles) * carrier
            found[start : start + some] += moments @ coefficients[:, order]
    return found


def _warn_where_rough(name: str, lengths: np.ndarray, values: np.ndarray) -> None:
    coefficients = np.abs(np.einsum("pk,nkc->npc", _TO_LEGENDRE, values))
    moving = np.einsum("npc,n->p", coefficients[:, 1:], lengths)
    share = moving[-1] / max(moving.sum(), 1e-300)
    if share > UNRESOLVED:
        warnings.warn(
            f"{name} changes within the steps of the run by more than they resolve (cubic terms are {share:.0%} of "
            "it): the spectrum is rough beyond the steps' own frequencies. Simulate with a smaller rtol",
            SpectrumWarning,
            stacklevel=4,
        )


@lru_cache(maxsize=64)
def _value_of(name: str):
    """One function for the same quantity: programs are kept by function."""

    def value(system: System, t: Scalar, y: Float[Array, " size"]) -> Array:
        return jnp.asarray(value_at(system, t, y, name))

    return value
