"""What the force laws look like by themselves (Figs 6, 7 and 8)."""

import re
from collections.abc import Mapping, Sequence
from itertools import cycle

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.output.plot.style import LAW_COLORS, LAW_DASHES, legend_below, letter, new_figure, note, repeated
from spherejax.physics.joints.contact import stiffness_of
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.laws.film import film_force, hybrid_weight
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.impact import maximum_penetration, realized_restitution
from spherejax.physics.laws.normal import AbstractHysteresisLaw, AbstractNormalLaw, ExactRestitution, Hertz, by_factor
from spherejax.program_cache import cached_jit

ImpactLaw = Hertz | AbstractHysteresisLaw
"""A law whose free impact is known in closed form."""

_IMPACT_STEPS = 4000
"""Runge-Kutta steps over one impact; its error is then far below a line's width."""


def impact_loops(
    families: Mapping[float, Sequence[ImpactLaw]],
    *,
    mass: float = 0.03,
    rate: float = 0.1,
    stiffness: float,
) -> Figure:
    """Force against penetration during one free impact, a panel for each prescribed restitution (Fig. 6).

    The legend says which restitution each law realizes. Integrated with 4000 steps of Runge and Kutta's method.

    Args:
        families: normal laws with `hysteresis_factor`, by the restitution that was prescribed to them.
        mass: effective mass m_i m_j/(m_i + m_j) [kg].
        rate: penetration rate at the onset [m/s].
        stiffness: K [N/m**1.5], e.g. by `generalized_stiffness`.

    Raises:
        SceneError: for a number that is not positive, or without a law.
    """
    for name, value in (("mass", mass), ("rate", rate), ("stiffness", stiffness)):
        if not 0 < value < np.inf:
            raise SceneError(f"impact_loops: {name} = {value!r} must be positive and finite")
    if not families:
        raise SceneError("impact_loops: there is no law to draw; give {0.9: [sj.Hertz(), ...]}")
    title = f"Free impact: {mass * 1e3:g} g (effective) at {rate:g} m/s, K = {stiffness:.4g} N/m$^{{1.5}}$"
    figure, axes = new_figure(1, len(families), 4.6 * len(families), 4.8, title)
    for ax, (restitution, laws) in zip(axes.flat, families.items(), strict=True):
        styles = zip(repeated(LAW_COLORS, len(laws)), repeated(LAW_DASHES, len(laws)), strict=True)
        damped = []
        for given, (color, dashes) in zip(laws, styles, strict=True):
            law = given.at_onset(rate) if isinstance(given, AbstractHysteresisLaw) else given
            penetration, force = _free_impact(law, mass, rate, stiffness)
            realized = realized_restitution(float(law.hysteresis_factor()))
            label = f"{_name(law)} (realizes {realized:.3f})"
            ax.plot(1e6 * penetration, force, color=color, ls=dashes, lw=1.4, label=label)
            damped.append((1e6 * penetration, force - stiffness * penetration**1.5, {"color": color, "ls": dashes}))
        ax.set_xlabel("penetration [µm]")
        ax.set_ylabel("contact force [N]")
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        ax.set_title(f"prescribed restitution {restitution:g}", loc="left", fontsize=9)
        ax.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, frameon=False)
        if len(laws) > 1 and max(np.abs(own).max() for _, own, _ in damped) < SLENDER * ax.dataLim.ymax:
            _damping_alone(ax, damped)
    letter(list(axes.flat))
    return figure


SLENDER = 0.15
"""Loops whose damping is below this share of the largest force lie on each other."""


def _damping_alone(ax: Axes, damped: Sequence[tuple[np.ndarray, np.ndarray, dict]]) -> None:
    """A close-up where loops lie on each other: the elastic force taken off, which all have in common."""
    inset = ax.inset_axes((0.12, 0.54, 0.42, 0.36))
    inset.set_in_layout(False)
    for penetration, force, style in damped:
        inset.plot(penetration, force, lw=1.1, **style)
    inset.set_title("damping force alone [N]", fontsize=7.5)
    inset.tick_params(labelsize=6.5)
    inset.grid(False)


def _free_impact(law: ImpactLaw, mass: float, rate: float, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Penetration [m] and force [N] from onset to separation."""
    factor = float(law.hysteresis_factor())
    numbers = map(np.float64, (factor, realized_restitution(factor), mass, rate, stiffness))
    # Laws that differ in their factor alone are one program.
    penetrations, force = map(np.asarray, _integrated_impact(by_factor(law), *numbers))
    touching = (penetrations >= 0) & (np.cumsum(penetrations < 0) == 0)
    return np.append(penetrations[touching], 0.0), np.append(force[touching], 0.0)


@cached_jit(what="a free impact")
def _integrated_impact(
    law: AbstractNormalLaw, factor: Scalar, restitution: Scalar, mass: Scalar, rate: Scalar, stiffness: Scalar
):
    """Penetrations and forces of an impact and of the time after it, shape (n,) each."""
    deepest = maximum_penetration(mass, rate, factor, stiffness)
    # Compression takes 1.47 deepest / rate without damping; restitution takes longer by the lost speed.
    step = 2.0 * (1.0 + 1.0 / restitution) * deepest / rate / _IMPACT_STEPS

    def slope(y):
        return jnp.array([y[1], -law.force(y[0], y[1], rate, stiffness) / mass])

    def advance(y, _):
        k1 = slope(y)
        k2 = slope(y + step / 2 * k1)
        k3 = slope(y + step / 2 * k2)
        k4 = slope(y + step * k3)
        return y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), y

    _, path = jax.lax.scan(advance, jnp.array([0.0, rate]), length=_IMPACT_STEPS)
    return path[:, 0], jax.vmap(lambda y: law.force(y[0], y[1], rate, stiffness))(path)


def friction_curves(
    laws: Sequence[AbstractFrictionLaw],
    title: str = "Friction laws in steady sliding",
    *,
    fastest: float = 4e-3,
    close_up: float = 4e-4,
) -> Figure:
    """Friction coefficient against sliding velocity in steady sliding, and its close-up near zero (Fig. 7).

    Args:
        laws: the laws to draw; one that cannot be simulated (Coulomb's) is drawn as the reference, grey and wide.
        title: what is shown.
        fastest: largest sliding velocity of the left panel [m/s].
        close_up: largest sliding velocity of the right panel [m/s].
    """
    figure, axes = new_figure(1, 2, 9.2, 4.2, title)
    for ax, limit, name in zip(axes.flat, (fastest, close_up), ("all velocities", "near zero sliding"), strict=True):
        _draw_friction(ax, laws, limit)
        ax.set_title(name, loc="left", fontsize=9)
    legend_below(figure, axes[0, 0])
    letter(list(axes.flat))
    return figure


def _draw_friction(ax: Axes, laws: Sequence[AbstractFrictionLaw], limit: float) -> None:
    velocities = np.linspace(-limit, limit, 4001)
    styles = zip(cycle(LAW_COLORS), cycle(LAW_DASHES), strict=False)
    for law in laws:
        coefficients = np.asarray(_coefficients(law, np.abs(velocities))) * np.sign(velocities)
        if law.simulable:
            color, dashes = next(styles)
            ax.plot(1e3 * velocities, coefficients, color=color, ls=dashes, lw=1.4, label=_name(law))
        else:
            ax.plot(1e3 * velocities, coefficients, color="0.75", lw=4, label=f"{_name(law)} (reference)")
    ax.set_xlabel("sliding velocity [mm/s]")
    ax.set_ylabel("friction force / normal force [-]")
    ax.set_xlim(-1e3 * limit, 1e3 * limit)


@cached_jit(what="a friction law")
def _coefficients(law: AbstractFrictionLaw, speeds: Float[Array, " n"]) -> Float[Array, " n"]:
    """Coefficients in steady sliding."""
    return jax.vmap(law.coefficient)(speeds)


def hybrid_force(joint: Lubricated, *, rate: float = 1e-4) -> Figure:
    """Film, contact and blended force of a lubricated joint across e = c, in the clearance and around its end (Fig. 8).

    Args:
        joint: the joint model.
        rate: speed at which the ball approaches the wall [m/s].

    Raises:
        SceneError: for another model.
    """
    if not isinstance(joint, Lubricated):
        raise SceneError(f"hybrid_force: {type(joint).__name__} has no film; give a sj.Lubricated(...)")
    c, c_mm = float(joint.clearance), 1e3 * float(joint.clearance)
    title = f"Lubricated joint: c = {c_mm:g} mm, {float(joint.viscosity):g} Pa s, approach at {1e3 * rate:g} mm/s"
    figure, axes = new_figure(1, 2, 9.2, 4.2, title)
    intervals = ((0.0, 1.06 * c), (c - 3e-6, c + 4e-6))
    for ax, (low, high), name in zip(axes.flat, intervals, ("whole clearance", "around e = c"), strict=True):
        _draw_hybrid(ax, joint, np.linspace(low, high, 2001), rate)
        ax.set_xlim(1e3 * low, 1e3 * high)
        ax.set_xlabel("eccentricity [mm]")
        ax.set_ylabel("resisting force [N]")
        ax.set_title(name, loc="left", fontsize=9)
    axes[0, 0].set_yscale("log")
    axes[0, 0].set_ylim(1.0, 1e4)
    legend_below(figure, axes[0, 0])
    note(axes[0, 1], "dotted lines: e = c and e = c + e_h0", place=(0.02, 0.9))
    letter(list(axes.flat))
    return figure


@cached_jit(what="a lubricated joint's forces")
def _hybrid_forces(joint: Lubricated, rate: Scalar, eccentricities: Float[Array, " n"]):
    """Film, contact and blend [N] at each of the eccentricities [m]."""
    stiffness = stiffness_of(joint.normal, joint.surfaces)

    def forces(e):
        direction = jnp.array([1.0, 0.0, 0.0])
        film = -film_force(
            e * direction,
            rate * direction,
            joint.clearance,
            joint.socket_radius,
            joint.viscosity,
            joint.boundary,
            joint.e_h1,
        )[0]
        contact = joint.normal.force(e - joint.clearance, rate, rate, stiffness)
        weight = hybrid_weight(e, joint.clearance, joint.e_h0)
        return film, contact, (1 - weight) * film + weight * contact

    return jax.vmap(forces)(eccentricities)


def _draw_hybrid(ax: Axes, joint: Lubricated, eccentricities: np.ndarray, rate: float) -> None:
    film, contact, blend = map(np.asarray, _hybrid_forces(joint, np.float64(rate), eccentricities))
    x = 1e3 * eccentricities
    # By itself the film would grow beyond all bounds at e = c + e_h1, where contact has taken over long ago.
    ax.set_ylim(0.0, 1.6 * np.max(blend[eccentricities < joint.clearance + 2 * joint.e_h0]))
    ax.plot(x, blend, color="0.7", lw=5, label="blend: the joint's force")
    ax.plot(x, film, color=LAW_COLORS[2], lw=1.4, label="squeeze film alone")
    ax.plot(
        x,
        np.where(contact > 0, contact, np.nan),
        color=LAW_COLORS[1],
        lw=1.4,
        dashes=(5, 2),
        label="dry contact alone",
    )
    for place in (joint.clearance, joint.clearance + joint.e_h0):
        ax.axvline(1e3 * float(place), color="0.3", lw=0.8, ls=":")


def _name(law) -> str:
    """`"Hunt-Crossley"` from the class name of a law."""
    if isinstance(law, ExactRestitution):
        return "exact"
    return re.sub(r"(?<=[a-z])(?=[A-Z])(?<!Mc)", "-", type(law).__name__)
