"""Contacts of a joint one by one within `jax.jit`, `jax.vmap` and `jax.grad`: a fixed number of rows, with a mask.

Where contacts begin and end, and which steps have their peaks, is looked for without derivatives, at the steps of the
repeated run, as `impacts.impacts` does it. The states in these steps are then taken again, with their derivatives by
the numbers of the scene at fixed times (`between.states_at`):

* The onset and the release are roots of the crossing function g, with the derivative of the implicit function,

      dt*/dp = -(dg/dp at fixed t) / (dg/dt),

  of the polynomial through eight instants of the step that ends there: the state before the event.
* The peaks are those of such polynomials, with the partial derivative at their instants.
* Integrals are by Gauss and Legendre's rule in each step of the contact. Their instants move with onset and release,

      t(p) = onset + share (release - onset),

  so that each has the derivative along its own share of the contact. At fixed times the derivative of a force that
  begins as depth^1.5 would begin as depth^0.5, which the rule takes with an error of 1e-3.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.checks import is_concrete, is_tracing, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Flag, Scalar
from spherejax.model.system import flatten_by_factor
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.problem import Plan
from spherejax.motion.integration.status import Status
from spherejax.motion.results.between import states_at
from spherejax.motion.results.impacts import require_contact, touch_of
from spherejax.motion.results.steps import SHARE_WEIGHTS, SHARES, Repetition, repeated_in_steps, room_for_steps
from spherejax.motion.results.traced_steps import largest_within, refusing, repetition_of, seen_at_steps
from spherejax.motion.results.within_steps import COEFFICIENTS, LARGEST_RISE, NODES, place_of_maximum

STEPS_OF_A_CONTACT = 32
"""Steps in contact for which there is room, for each row: an impact at a tolerance of 1e-9 takes 10 to 25."""

JUMPS = (
    "a contact of joint {joint!r} has its largest {what} at the end of a step, where its force jumps, or begins "
    "without a normal velocity: the instant moves with the numbers in a way that the derivative does not contain. Take "
    "differences of runs"
)


class ImpactRows(eqx.Module):
    """The contacts of a joint in the order of their onsets, a fixed number of rows; see `Trajectory.impact_rows`.

    Attributes:
        is_contact: whether the row is a contact, shape (rows,); the other rows are zeros.
        onset: when contact begins [s], shape (rows,); the start of the run for a ball that touches there.
        release: when it ends [s]; NaN where the run ends first.
        approach_speed: normal velocity at the onset [m/s].
        sliding_speed: tangential velocity of the surfaces at the onset [m/s].
        peak_force: largest force on the ball [N].
        peak_penetration: largest |e| - c [m].
        impulse: of the force on the ball, world axes [N s], shape (rows, 3).
        energy_lost: absorbed by the joint, less what it stores [J].
        place: unit vector from the socket's center to the contact at the onset, axes of the socket's body, (rows, 3).
        n_contacts: how many contacts the run has.
        n_steps: how many steps.
        n_contact_steps: how many of these in contact.
    """

    is_contact: Bool[Array, " rows"]
    onset: Float[Array, " rows"]
    release: Float[Array, " rows"]
    approach_speed: Float[Array, " rows"]
    sliding_speed: Float[Array, " rows"]
    peak_force: Float[Array, " rows"]
    peak_penetration: Float[Array, " rows"]
    impulse: Float[Array, "rows 3"]
    energy_lost: Float[Array, " rows"]
    place: Float[Array, "rows 3"]
    n_contacts: Int[Array, ""]
    n_steps: Int[Array, ""]
    n_contact_steps: Int[Array, ""]


class _Spans(NamedTuple):
    """Steps: where they begin, and how long they are [s]."""

    begin: Array
    length: Array

    def instants(self, shares: Any) -> Array:
        """Shares of each step [s], shape (..., k)."""
        return self.begin[..., None] + jnp.asarray(shares) * self.length[..., None]


class _Top(NamedTuple):
    """Where a quantity is largest in a contact.

    Attributes:
        step: the two steps with the largest values within, shape (rows, 2).
        time: an end of a step with the largest value of all of these [s].
        value: that value.
        is_at_end: whether it is larger than all within steps.
    """

    step: _Spans
    time: Array
    value: Array
    is_at_end: Array


class _Places(NamedTuple):
    """Where the contacts are, in rows.

    Attributes:
        is_contact: whether the row is one.
        before: the step that ends at the onset.
        last: the step that ends at the release.
        begins_with_run, ends_with_run: contacts that the run begins and ends with.
        force, penetration: where they are largest.
        stored_behind, stored_after: energy [J] just behind the onset, and behind the release.
        pool: all steps in contact.
        row: which contact each of them belongs to; `rows` for none.
        n_contacts, n_steps, n_contact_steps: how many there are.
    """

    is_contact: Array
    before: _Spans
    last: _Spans
    begins_with_run: Array
    ends_with_run: Array
    force: _Top
    penetration: _Top
    stored_behind: Array
    stored_after: Array
    pool: _Spans
    row: Array
    n_contacts: Array
    n_steps: Array
    n_contact_steps: Array


def impact_rows(run: Any, joint: str, rows: int, steps: int, contact_steps: int | None) -> ImpactRows:
    """Every contact of a joint of a single run, traced or not; see `Trajectory.impact_rows`."""
    require_contact(run.system, joint)
    if n_axes := jnp.ndim(run.ended):
        raise SceneError(
            f"impact_rows is of a single run, and these have {n_axes} axes; write "
            f"jax.vmap(lambda run: run.impact_rows({joint!r}))(runs)"
        )
    room = STEPS_OF_A_CONTACT * rows if contact_steps is None and isinstance(rows, int) else contact_steps
    for name, value in (("rows", rows), ("steps", steps), ("contact_steps", room)):
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise SceneError(f"{name} = {shown(value)} must be a whole number, at least 1: for how many there is room")
    are_known = all(map(is_concrete, (run.ys, run.ended, run.t_reached))) and not is_tracing()
    steps = room_for_steps(int(run.stats.n_accepted)) if are_known else steps
    plan, again = repetition_of(run)
    look: Any = partial(_looked, plan, joint, rows, steps, min(int(room or 1), steps))
    if not are_known:
        look = jax.custom_batching.sequential_vmap(look)
    places: _Places = look(jax.lax.stop_gradient(jax.tree.map(jnp.asarray, again)))
    is_known = (places.n_contacts <= rows) & (places.n_steps <= steps)
    is_known = is_known & (places.n_contact_steps <= min(int(room or 1), steps))
    return _with_derivatives(run, joint, rows, places, is_known)


# Where, without derivatives ------------------------------------------------------------------------------------------


def _looked(plan: Plan, joint: str, rows: int, steps: int, room: int, again: Repetition) -> _Places:
    theta, y0, ends = again.theta, again.y0, again.ends
    begin, k = ends[0], len(SHARES) + 1
    # A run of two samples has no states within steps.
    outcome, log = repeated_in_steps(plan, steps, again, jnp.stack([begin, (begin + ends[1]) / 2, ends[1]]))
    n = outcome.n_accepted[0]
    program = program_for(touch_of(joint), plan.structure, plan.scalar, is_quiet=True)

    def see(t, y):
        touch = program(theta, t, y)
        return jnp.stack([touch.onset_rate, safe_norm(touch.force), touch.penetration, touch.elastic_energy])

    seen = seen_at_steps(see, 4, log.times[0].ravel(), log.states[0].reshape(steps * k, -1), n * k)
    seen = seen.reshape(steps, k, 4)
    is_step = jnp.arange(steps) < n
    # End i of steps is where step i begins; end 0 the start of the run.
    at_ends = jnp.concatenate([see(begin, y0)[None], seen[:, -1]])
    times = jnp.concatenate([begin[None], jnp.where(is_step, log.times[0, :, -1], ends[1])])
    spans = _Spans(times[:-1], jnp.where(is_step, times[1:] - times[:-1], 0.0))
    touches = (at_ends[:, 0] > 0) & (jnp.arange(steps + 1) <= n)
    is_onset = touches & ~jnp.concatenate([jnp.array([False]), touches[:-1]])
    first = jnp.nonzero(is_onset, size=rows, fill_value=steps)[0]
    is_contact = jnp.arange(rows) < jnp.sum(is_onset)
    index = jnp.arange(steps + 1)
    is_behind = (index[None] > first[:, None]) & ~touches[None]
    # Without an end of contact behind it a row goes on to the end of the run.
    goes_on = ~jnp.any(is_behind & (index <= n), axis=1)
    end = jnp.where(goes_on, n, jnp.argmax(is_behind, axis=1))
    own_steps = is_contact[:, None] & (index[None, :-1] >= first[:, None]) & (index[None, :-1] < end[:, None])
    own_ends = is_contact[:, None] & (index[None] >= first[:, None]) & (index[None] < end[:, None] + goes_on[:, None])
    in_contact = is_step & touches[:-1]
    pool = jnp.nonzero(in_contact, size=room, fill_value=steps)[0]
    is_used = jnp.arange(room) < jnp.sum(in_contact)
    of_pool = jax.tree.map(lambda x: jnp.where(is_used, x[jnp.minimum(pool, steps - 1)], 0.0), spans)
    row = jnp.cumsum(is_onset)[jnp.minimum(pool, steps)] - 1
    at_first, at_end = at_ends[first], at_ends[end]

    def step(i):
        """Step i; of none a length of zero at the start of the run."""
        is_one = is_contact & (i >= 0)
        begins, lengths = (x[jnp.clip(i, 0, steps - 1)] for x in spans)
        return _Spans(jnp.where(is_one, begins, begin), jnp.where(is_one, lengths, 0.0))

    force, penetration = (
        _top(seen[..., column], at_ends[:, column], times, step, own_steps, own_ends, is_contact) for column in (1, 2)
    )
    return _Places(
        is_contact=is_contact,
        before=step(first - 1),
        last=step(end - 1),
        begins_with_run=is_contact & (first == 0),
        ends_with_run=is_contact & goes_on,
        force=force,
        penetration=penetration,
        stored_behind=jnp.where(is_contact, at_first[:, 3], 0.0),
        stored_after=jnp.where(is_contact, at_end[:, 3], 0.0),
        pool=_Spans(jnp.where(is_used, of_pool.begin, begin), of_pool.length),
        row=jnp.where(is_used, row, rows),
        n_contacts=jnp.sum(is_onset),
        n_steps=n,
        n_contact_steps=jnp.sum(in_contact),
    )


def _top(seen, at_ends, times, step, own_steps, own_ends, is_contact) -> _Top:
    """Where a quantity is largest in each contact, seen at four instants within its steps and by their ends."""
    best = jnp.where(own_steps, largest_within(seen[:, :-1])[None], -jnp.inf)
    highest, two = jax.lax.top_k(best, 2) if best.shape[1] > 1 else (best, jnp.zeros(best.shape, int))
    ends = jnp.where(own_ends, at_ends[None], -jnp.inf)
    at = jnp.argmax(ends, axis=1)
    value = jnp.where(is_contact, at_ends[at], 0.0)
    time = jnp.where(is_contact, times[at], times[0])
    # The cubic is wrong by 1e-5 or so; of a peak beside the end of a step the octic says more.
    is_at_end = is_contact & (value > highest[:, 0] + 1e-4 * jnp.abs(highest[:, 0]))
    return _Top(jax.vmap(step, 1, 1)(jnp.where(jnp.isfinite(highest), two, two[:, :1])), time, value, is_at_end)


# What, with derivatives ----------------------------------------------------------------------------------------------


def _with_derivatives(run: Any, joint: str, rows: int, places: _Places, is_known: Flag) -> ImpactRows:
    begin, end = jnp.asarray(run.ts)[0], jnp.where(run.ended == Status.SUCCEEDED, run.ts[-1], run.t_reached)
    fixed_begin, fixed_end = jax.lax.stop_gradient((begin, end))
    tops = places.force, places.penetration
    parts = [
        places.before.instants(NODES),
        places.last.instants(NODES),
        *(top.step.instants(NODES) for top in tops),
        jnp.stack([top.time for top in tops], axis=1),
        jnp.stack([fixed_begin, fixed_end]),
        places.pool.instants(SHARES),
    ]
    times = jnp.clip(jnp.concatenate([jnp.ravel(part) for part in parts]), fixed_begin, fixed_end)
    ys = states_at(run, jax.lax.stop_gradient(times)).y
    structure, theta = flatten_by_factor(run.system)
    program = program_for(touch_of(joint), structure, run.scalar, is_quiet=True)
    theta = jnp.asarray(theta)
    touch = jax.vmap(lambda t, y: program(theta, t, y))
    sizes = [part.size for part in parts]
    n_seen = sum(sizes) - parts[-1].size
    seen, at, split = touch(times[:n_seen], ys[:n_seen]), 0, []
    for part in parts:
        take = partial(_rows, at, part.shape)
        split.append((part, take(ys), jax.tree.map(take, seen) if at < n_seen else None))
        at += part.size
    before, last, force, penetration, at_tops, at_run, pool = split

    onset = _event(places.before, before, begin, places.begins_with_run, places.is_contact)
    release = _event(places.last, last, end, places.ends_with_run, places.is_contact)
    pool_times, pool_states, stretch = _moved(run, structure, theta, places, pool, onset, release)
    behind = touch(jnp.concatenate([onset.time, pool_times]), jnp.concatenate([onset.state, pool_states]))
    at_onset, in_pool = jax.tree.map(lambda leaf: leaf[:rows], behind), jax.tree.map(lambda leaf: leaf[rows:], behind)
    # In contact all along its last step.
    approach = last[2].onset_rate[:, 0]
    at_start = jax.tree.map(lambda leaf: leaf[0], at_run[2])
    first = jax.tree.map(
        lambda there, start: jnp.where(_as_rows(places.begins_with_run, there), start, there), at_onset, at_start
    )
    forces = safe_norms(force[2].force)
    ends_force, ends_depth = safe_norms(at_tops[2].force)[:, 0], at_tops[2].penetration[:, 1]
    run_ends = jnp.stack([fixed_begin, fixed_end])
    peak_force, force_moves = _peaks(places.force, forces, ends_force, run_ends)
    peak_depth, depth_moves = _peaks(places.penetration, penetration[2].penetration, ends_depth, run_ends)

    weights = jnp.asarray(SHARE_WEIGHTS) * (places.pool.length * stretch)[:, None]
    own = (places.row, rows + 1)
    push = jnp.einsum("nk,nki->ni", weights, in_pool.force.reshape(*weights.shape, 3))
    impulse = jax.ops.segment_sum(push, *own)[:rows]
    power = in_pool.absorbed_power.reshape(weights.shape)
    absorbed = jax.ops.segment_sum(jnp.sum(weights * power, axis=1), *own)[:rows]
    stored = at_run[2].elastic_energy
    stored_behind = jnp.where(places.begins_with_run, stored[0], places.stored_behind)
    stored_after = jnp.where(places.ends_with_run, stored[1], places.stored_after)

    has_instants = onset.has_derivative & release.has_derivative
    refuse = partial(_refused, joint)
    columns = {
        "onset": refuse("force", onset.time, onset.has_derivative),
        "release": jnp.where(places.ends_with_run, jnp.nan, refuse("force", release.time, release.has_derivative)),
        "approach_speed": approach,
        "sliding_speed": safe_norms(first.sliding),
        "peak_force": refuse("force", peak_force, ~force_moves),
        "peak_penetration": refuse("penetration", peak_depth, ~depth_moves),
        "impulse": refuse("force", impulse, has_instants),
        "energy_lost": refuse("force", absorbed - (stored_after - stored_behind), has_instants),
        "place": first.place,
    }
    has_parted = places.is_contact & ~(onset.is_near & release.is_near)
    is_known = is_known & ~jnp.any(has_parted)
    columns = {
        name: jnp.where(is_known, jnp.where(_as_rows(places.is_contact, column), column, 0.0), jnp.nan)
        for name, column in columns.items()
    }
    # Sums over the rows that are contacts must not pass over what is not known.
    is_contact = places.is_contact | ~is_known
    return ImpactRows(
        is_contact,
        **columns,
        n_contacts=places.n_contacts,
        n_steps=places.n_steps,
        n_contact_steps=places.n_contact_steps,
    )


def _rows(at: int, shape: tuple, leaf: Array) -> Array:
    """A part of an array's rows, in a shape."""
    size = 1
    for length in shape:
        size *= length
    return leaf[at : at + size].reshape(*shape, *leaf.shape[1:])


def _as_rows(mask: Array, leaf: Array) -> Array:
    return mask.reshape(mask.shape + (1,) * (leaf.ndim - mask.ndim))


def safe_norms(vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """|v| of each row, with derivative 0 at 0."""
    return jax.vmap(safe_norm)(vectors.reshape(-1, 3)).reshape(vectors.shape[:-1])


def _refused(joint: str, what: str, values: Array, has_derivative: Array) -> Array:
    """The values, whose derivatives raise where they have none, while the program runs."""
    return refusing(JUMPS.format(joint=joint, what=what), values, jnp.all(has_derivative))


class _Event(NamedTuple):
    """Onsets or releases, in rows.

    Attributes:
        time: when [s].
        delay: from the end of the step on [s]: zero but for rounding, with the derivative of the instant.
        state: the flat state just before, with its derivative along with the instant.
        is_near: whether the motion with derivatives has the event in that step, too.
        has_derivative: whether the crossing function passes zero there.
    """

    time: Array
    delay: Array
    state: Array
    is_near: Array
    has_derivative: Array


def _event(spans: _Spans, part: tuple, limit: Scalar, is_limit: Array, is_contact: Array) -> _Event:
    """The instants at the ends of steps, roots of the crossing function; or a start or end of the run."""
    _, states, seen = part
    half = jnp.where(spans.length > 0, spans.length / 2, 1.0)
    at_end = jnp.sum(jnp.asarray(COEFFICIENTS), axis=0)  # each power of s is 1 there
    slope_at_end = jnp.arange(len(NODES) - 1, -1, -1) @ jnp.asarray(COEFFICIENTS)
    t, y = spans.begin + spans.length, jnp.einsum("k,rks->rs", at_end, states)
    rate = jax.lax.stop_gradient(jnp.einsum("k,rks->rs", slope_at_end, states) / half[:, None])
    slope = jax.lax.stop_gradient(seen.crossing @ slope_at_end / half)
    is_root, passes = is_contact & ~is_limit, slope != 0
    delay = jnp.where(is_root & passes, -(seen.crossing @ at_end) / jnp.where(passes, slope, 1.0), 0.0)
    is_near = ~is_root | (jnp.abs(delay) <= spans.length)
    time = jnp.where(is_limit, limit, t + delay)
    state = y + rate * delay[:, None]
    delay = jnp.where(is_limit, limit - jax.lax.stop_gradient(limit), delay)
    return _Event(time, delay, state, is_near, ~is_root | passes)


def _moved(run: Any, structure, theta: Array, places: _Places, pool: tuple, onset: _Event, release: _Event) -> tuple:
    """The instants in contact as they move with onset and release, the flat states there, and what they stretch by."""
    begins, ends = (jax.lax.stop_gradient(jnp.append(event.time, 0.0))[places.row] for event in (onset, release))
    at_begin, at_end = (jnp.append(event.delay, 0.0)[places.row] for event in (onset, release))
    duration = jnp.where(ends > begins, ends - begins, 1.0)
    times, states, _ = pool
    share = (times - begins[:, None]) / duration[:, None]
    shift = (at_begin[:, None] + share * (at_end - at_begin)[:, None]).ravel()
    times, states = times.ravel(), states.reshape(shift.size, -1)
    program = program_for(state_rate, structure, run.scalar)
    fixed = jax.lax.stop_gradient((theta, times, states))
    rates = jax.vmap(lambda t, y: program(fixed[0], t, y))(*fixed[1:])
    return fixed[1] + shift, states + rates * shift[:, None], 1 + (at_end - at_begin) / duration


def _peaks(top: _Top, at_nodes: Array, at_ends: Array, run_ends: Array) -> tuple[Array, Array]:
    """The largest values, and whether their instants move in a way that their derivatives do not contain."""

    def within(values):
        coefficients = jnp.asarray(COEFFICIENTS) @ values
        return jnp.polyval(coefficients, place_of_maximum(jax.lax.stop_gradient(coefficients)))

    inside = jax.vmap(jax.vmap(within))(at_nodes)
    highest = jnp.max(at_nodes, axis=2)
    is_believed = (inside >= highest) & (inside <= highest + LARGEST_RISE * jnp.abs(highest))
    inside = jnp.max(jnp.where(is_believed, inside, highest), axis=1)
    is_fixed = jnp.any(top.time[:, None] == run_ends, axis=1)
    # What a joint does just behind an event is in the steps alone, without a derivative.
    at_ends = jnp.where(is_fixed, at_ends, top.value)
    is_at_end = top.is_at_end | (is_fixed & (top.value > inside))
    return jnp.where(is_at_end, at_ends, inside), is_at_end & ~is_fixed
