"""A state and its sensitivities as rows of one matrix, and what happens to them: rates, corrections, contact onsets.

Sensitivities Y_k = s_k dy/dp_k are integrated together with the state (s_k is the size of p_k, see `scales_of`, so that
all are in the units of the state),

    y_rate = f(y, p),    Y_k_rate = df/dy Y_k + s_k df/dp_k,

as rows of one matrix: y first, then one Y_k for each number. The step-size controller judges every row. That is
needed behind a contact onset, where df/dy grows like the root of time: steps that are right for the motion, whose
force grows like the power 3/2, are too long for its sensitivities.

At a contact onset the instant tau moves with the numbers. A step lands just behind it, and there

    Y_k := Y_k + (f_flight - f_contact) s_k dtau/dp_k,

while the memory's part jumps as `contacts.memory_after_step` says. The force of the landing window is below a
micronewton, and yet without this term each impact would add a relative error of 1e-7: contact stiffens from zero with
an infinite slope. Bristles, which begin to move at the onset, need the term in full.

Sample times are numbers too: a sample y(t_i) moves by f dt_i. The first one, t_0, is where the motion begins with the
state y_0. A motion that begins later, at t_0 + dt_0, is at t_0 where that state would have come from, so its row is

    Y_rate = df/dy Y,    Y(t_0) = dy_0/dt_0 - f(t_0, y_0);

at onsets it jumps as all rows do. Where time enters neither f nor y_0 by itself, Y = -f at all times, and there is no
row: only differences t_i - t_0 count.
"""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.lanes import in_lanes
from spherejax.motion.equations.contacts import GRAZING_RATE
from spherejax.motion.equations.programs import Program
from spherejax.motion.integration.unseen import Unseen
from spherejax.motion.solvers.landing import ContactFunctions

SMALLEST_IN_ARRAY, SMALLEST_SCALE = 1e-6, 1e-9
"""Lower bounds of scales: of numbers in arrays, and of numbers by themselves.

A coordinate of 1e-17 m is zero but for rounding. Scaled by its own size, its sensitivity is 1e-17 times the state, and
its errors vanish in the state's absolute tolerance: step-size control no longer sees them."""

FEW_ARRAYS = 16
"""Number of arrays up to which each is reduced by an operation of its own.

A gather over all arrays takes 0.1 ms for the 4,417 weights of a network, which are few and large arrays. A scene of
many bodies has thousands of arrays, and one operation for each would be slow to compile."""


def scales_of(values: Any, arrays: Int[np.ndarray, " p"] | None = None) -> Any:
    """Scales s_k of the numbers, shape (p,): the largest magnitude in the array of each; 1 where all of it are 0.

    Known numbers are evaluated by NumPy: each operation outside of `jax.jit` would be a program of JAX's.

    Args:
        values: the numbers.
        arrays: index of the array that each number belongs to, ascending from 0; None: each is an array by itself.
    """
    xp: Any = np if is_concrete(values) else jnp
    sizes, smallest = xp.abs(xp.asarray(values)), SMALLEST_SCALE
    counts = np.zeros(0, int) if arrays is None or not arrays.size else np.bincount(arrays)
    are_few = counts.size <= FEW_ARRAYS
    if counts.size:
        first = np.cumsum(counts) - counts
        if are_few:
            parts = [sizes[begin : begin + count] for begin, count in zip(first, counts, strict=True)]
            sizes = xp.stack([xp.max(part) for part in parts])
        else:
            # Picked, not scattered: XLA:CPU (jax 0.10) aborts where it compiles the derivative of a fused scatter.
            places = first[:, None] + np.minimum(np.arange(counts.max()), counts[:, None] - 1)
            sizes = xp.max(sizes[places], axis=1)
        smallest = np.where(counts > 1, SMALLEST_IN_ARRAY, SMALLEST_SCALE)
    if xp is jnp:
        sizes = jax.lax.stop_gradient(sizes)
    scales = xp.where(sizes == 0, 1.0, xp.maximum(sizes, smallest))
    if not counts.size:
        return scales
    if are_few:
        return xp.concatenate([xp.broadcast_to(scale, n) for scale, n in zip(scales, counts.tolist(), strict=True)])
    return scales[arrays]


def with_start_time(scales: Any, by_start: bool) -> Any:
    """The same with that of the first sample time behind them, one second, where sensitivities are by that as well."""
    if not by_start:
        return scales
    return np.append(scales, 1.0) if isinstance(scales, np.ndarray) else jnp.append(scales, 1.0)


class Linearized(NamedTuple):
    """Something that follows from the traced numbers, and its derivatives along directions in them.

    Attributes:
        value: the value.
        slopes: the derivatives, with a leading axis of directions; None for what is not a float.
    """

    value: Any
    slopes: Any


def linearized(function, values: Float[Array, " p"], directions: Float[Array, "k p"]) -> Linearized:
    """The value of a function of the traced numbers, and its derivatives."""

    def floats(values):
        return eqx.partition(function(values), lambda leaf: jnp.issubdtype(jnp.result_type(leaf), jnp.floating))

    def along(direction):
        return jax.jvp(floats, (values,), (direction,), has_aux=True)

    value, slopes, others = jax.vmap(along, out_axes=(None, 0, None))(directions)
    return Linearized(eqx.combine(value, others), slopes)


def rows_rate(rate: Program, parameters: Linearized, t, rows: Float[Array, "rows size"]) -> Float[Array, "rows size"]:
    """The right-hand side for the state and its sensitivities."""

    def state_rate(numbers, y):
        return rate.inside(numbers.theta, numbers.ahead, t, y)

    return rows_of(state_rate, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))


def rows_of(function, primals, slopes) -> Float[Array, "rows size"]:
    """A function's value as first row, its derivatives below."""

    def along(tangents):
        return eqx.filter_jvp(function, primals, tangents)

    value, tangents = eqx.filter_vmap(along, out_axes=(None, 0))(slopes)
    return jnp.concatenate([value[None], tangents])


def correcting_rows(correct: Callable | None) -> Callable | None:
    """The drift control's correction of the state and of its sensitivities."""
    if correct is None:
        return None

    def correct_rows(parameters, t, rows):
        def corrected(numbers, y):
            return correct(numbers, t, y)

        return rows_of(corrected, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))

    return correct_rows


def with_rows(contacts: ContactFunctions, rate: Program) -> ContactFunctions:
    """Contacts of the state in the first row; at an onset the sensitivities below it jump."""

    def crossings_of_state(parameters, t, y):
        return contacts.crossings(parameters.value, t, y)

    def crossings(parameters, t, rows):
        return crossings_of_state(parameters, t, rows[0])

    first_row = (lambda array: array[..., 0, :], crossings_of_state)
    if not contacts.onset_entries:
        return contacts._replace(crossings=crossings, first_row=first_row)

    def updated(parameters, t, start, end):
        """The rows with the memory updated, and how much later the onset comes with each number."""

        def of_state(numbers, y_start, y_end):
            return contacts.update(numbers, t, y_start, y_end)

        values = (parameters.value, start[0], end[0])
        rows = rows_of(of_state, values, (parameters.slopes, start[1:], end[1:]))
        weights = delay_weights(contacts, parameters.value, t, start[0], end[0], rows[0])
        return rows, jnp.sum(_crossing_slopes(contacts, parameters, t, end) * weights, 1)

    def rate_at(numbers, t, y):
        return rate.inside(numbers.theta, numbers.ahead, jnp.asarray(t), y)

    def jumped(rows, delays, rates):
        flight, contact = rates
        return jnp.concatenate([rows[:1], rows[1:] + delays[:, None] * (flight - contact)])

    def update(parameters, t, start, end):
        rows, delays = updated(parameters, t, start, end)
        rates = jax.vmap(lambda y: rate_at(parameters.value, t, y))(jnp.stack([end[0], rows[0]]))
        return jumped(rows, delays, rates)

    def update_lanes(parameters, t, start, end):
        rows, delays = in_lanes(updated)(parameters, t, start, end)

        def with_jumps():
            # A loop: fused with the sum, XLA would evaluate the right-hand side again for every entry of the state.
            states = jnp.stack([end[0], rows[0]])
            return jumped(rows, delays, jax.lax.map(lambda y: in_lanes(rate_at)(parameters.value, t, y), states))

        return jax.lax.cond(jnp.any(delays != 0), with_jumps, lambda: rows)

    entries = tuple((0, entry) for entry in contacts.onset_entries)
    return ContactFunctions(crossings, update, update_lanes, entries, first_row, contacts.kinks)


def delay_weights(contacts: ContactFunctions, parameters: Any, t, start, end, updated) -> Float[Array, " n_contacts"]:
    """By how much an onset comes later [s] for a unit of change of each crossing function there; 0 without an onset.

    Args:
        contacts: the contacts.
        parameters: what they are given.
        t: time at the end of the step [s].
        start: flat state at its start.
        end: at its end, in the mode of the start.
        updated: at its end, in the new mode.

    Limits: 0 for a grazing onset. Onsets in one step are taken as one, with the mean of their delays.
    """
    began = ~contacts.is_touching(start) & contacts.is_touching(updated)
    onset_rate = jnp.stack([updated[entry] for entry in contacts.onset_entries])
    counts = began & (onset_rate > GRAZING_RATE)
    rates = jnp.where(counts, contacts.crossings(parameters, t, end).rate[: contacts.n_contacts], 1.0)
    return -jnp.where(counts, 1 / rates, 0.0) / jnp.maximum(jnp.sum(counts), 1)


def _crossing_slopes(contacts: ContactFunctions, parameters: Linearized, t, rows) -> Float[Array, "k n_contacts"]:
    """Derivatives of the crossing functions at the end of a step."""

    def value(numbers, y):
        return contacts.crossings(numbers, t, y).value[: contacts.n_contacts]

    return rows_of(value, (parameters.value, rows[0]), (parameters.slopes, rows[1:]))[1:]


def of_first_row(function: Callable | None) -> Callable | None:
    """A function (parameters, t, y) of the state, as one of the rows that it stands above."""
    return None if function is None else lambda parameters, t, rows: function(parameters.value, t, rows[0])


def unseen_of_first_row(unseen: Unseen | None) -> Unseen | None:
    """What looks at functions of time, for a state that is one of rows."""
    signals: Any = None if unseen is None else of_first_row(unseen.signals)
    return None if unseen is None else unseen._replace(signals=signals)


LEAST_SHARE = 1e-6
"""Of the state's absolute tolerance, for a mixture that is small; below it rounding would be followed."""


def share_of_own_size(y0, y1, atol, rtol) -> Float[Array, " rows"]:
    """By how much the errors of rows are judged more strictly because the rows are small.

    A row of derivatives by numbers that hardly matter is far below the state, in the same units, and its errors vanish
    in the state's absolute tolerance. With this share each row is judged by its own largest part,

        share = max_i (|Y_i| rtol_i / atol_i),    within 1e-6 and 1,

    for then atol_i share is rtol_i times that part, in the units of the entry.

    Args:
        y0, y1: rows at both ends of a step, shape (rows, size) or with lanes behind.
        atol, rtol: tolerances of each entry.
    """
    is_absolute = atol > 0  # without an absolute tolerance errors are judged by the entry's own size already
    allowed = jnp.where(is_absolute, atol, 1.0)
    of_entries = jnp.where(is_absolute, jnp.maximum(jnp.abs(y0), jnp.abs(y1)) * rtol / allowed, jnp.inf)
    return jnp.clip(jnp.max(of_entries, axis=1), LEAST_SHARE, 1.0)


def judging_rows(controller, factor: float = 1.0, by_own_size: bool = False):
    """The controller with the norm of the worst row, so that many numbers do not dilute the error of one.

    Args:
        controller: a diffrax controller.
        factor: how much larger the errors of the sensitivities may be than those of the state.
        by_own_size: whether rows below the state are judged by `share_of_own_size`.
    """
    if not isinstance(controller, diffrax.PIDController):
        return controller
    norm = controller.norm

    def worst(errors):
        return jnp.maximum(norm(errors[0]), jnp.max(jax.vmap(norm)(errors[1:])) / factor)

    judging = eqx.tree_at(lambda c: c.norm, controller, worst)
    return (
        _ByOwnSize(**{field.name: getattr(judging, field.name) for field in fields(judging)})
        if by_own_size
        else judging
    )


class _ByOwnSize(diffrax.PIDController):
    """The controller for rows that are judged by `share_of_own_size`."""

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """As diffrax's, with errors that are larger by the share."""
        assert y_error is not None  # of a method that estimates none there is no such controller
        share = share_of_own_size(y0, y1_candidate, self.atol, self.rtol)
        error = jnp.concatenate([y_error[:1], y_error[1:] / share[1:, None]])
        return super().adapt_step_size(t0, t1, y0, y1_candidate, args, error, error_order, controller_state)
