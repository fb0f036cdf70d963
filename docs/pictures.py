"""Makes the pictures of the documentation, in docs/pictures: `python docs/pictures.py [NAME ...]`, a few minutes."""

import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import jax.numpy as jnp
import matplotlib

import spherejax as sj

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from PIL import Image
from scipy.optimize import brentq

FOLDER = Path(__file__).parent / "pictures"
MODELS = {
    "ideal": sj.Ideal(),
    "dry": sj.Dry(clearance=1e-4),
    "dry, friction": sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1)),
    "lubricated": sj.Lubricated(clearance=1e-4, viscosity=0.4),
    "bushing": sj.Bushing(stiffness=1e6, damping=1e-3),
}
LINES = ("black", "#0a7d91", "#8f1f7e", "#c8791a", "#4a7c2a")


def four_bar() -> Figure:
    """The four-bar with its dry joint magnified."""
    run = sj.simulate(
        sj.gallery.four_bar(MODELS["dry, friction"]), jnp.linspace(0.0, 0.2, 2001)
    )
    return sj.draw(run, t=0.15)


def accelerations() -> Figure:
    """What the joint's model does to the acceleration of the rocker."""
    ts = jnp.linspace(0.0, 0.2, 4001)
    figure, panels = plt.subplots(
        len(MODELS), 1, figsize=(7, 7), sharex=True, layout="constrained"
    )
    for panel, (name, model), color in zip(panels, MODELS.items(), LINES, strict=True):
        run = sj.simulate(sj.gallery.four_bar(model), ts, rtol=1e-7)
        panel.plot(
            1e3 * ts, run.acceleration("rocker")[:, 2], color=color, linewidth=0.8
        )
        panel.set_title(name, loc="left", fontsize=9)
        panel.margins(x=0)
    figure.supylabel("vertical acceleration of the rocker [m/s$^2$]", fontsize=10)
    panels[-1].set_xlabel("t [ms]")
    return figure


def orbits() -> Figure:
    """The ball's path in its clearance."""
    ts = jnp.linspace(0.0, 0.2, 4001)
    names = ("dry", "dry, friction", "lubricated")
    figure, panels = plt.subplots(
        1, 3, figsize=(8.4, 3.2), layout="constrained", sharey=True
    )
    angle = np.linspace(0, 2 * np.pi, 300)
    for panel, name in zip(panels, names, strict=True):
        run = sj.simulate(sj.gallery.four_bar(MODELS[name]), ts, rtol=1e-7)
        e = 1e6 * np.asarray(run.eccentricity("coupler_rocker"))
        panel.plot(
            100 * np.cos(angle), 100 * np.sin(angle), color="black", linewidth=1.2
        )
        panel.plot(
            e[:, 0], e[:, 2], color=LINES[list(MODELS).index(name)], linewidth=0.7
        )
        panel.set(aspect="equal", title=name, xlabel="e$_x$ [µm]")
    panels[0].set_ylabel("e$_z$ [µm]")
    return figure


def films() -> Figure:
    """The four-bar on the paper's film and on the full one: acceleration of the rocker, path of the ball."""
    ts = jnp.linspace(0.0, 2.0, 2001)
    kinds = {"the paper's film": sj.RadialFilm(), "full film": sj.FullFilm()}
    ideal = sj.simulate(sj.gallery.four_bar(sj.Ideal()), ts, rtol=1e-8)
    figure, panels = plt.subplots(
        2,
        2,
        figsize=(8.4, 5.6),
        layout="constrained",
        width_ratios=(2, 1),
        sharex="col",
    )
    angle = np.linspace(0, 2 * np.pi, 300)
    for (left, right), (name, film), color in zip(
        panels, kinds.items(), (LINES[3], LINES[1]), strict=True
    ):
        model = sj.Lubricated(clearance=1e-4, viscosity=0.4, film=film)
        run = sj.simulate(sj.gallery.four_bar(model), ts, rtol=1e-8)
        left.plot(ts, run.acceleration("rocker")[:, 2], color=color, linewidth=0.9)
        left.plot(
            ts,
            ideal.acceleration("rocker")[:, 2],
            color="black",
            linewidth=0.7,
            dashes=(4, 3),
            label="ideal joint",
        )
        left.set_title(name, loc="left", fontsize=9)
        left.margins(x=0)
        e = 1e6 * np.asarray(run.eccentricity("coupler_rocker"))
        right.plot(100 * np.cos(angle), 100 * np.sin(angle), "k", linewidth=1.2)
        right.plot(e[:, 0], e[:, 2], color=color, linewidth=0.7)
        right.set(aspect="equal", ylabel="e$_z$ [µm]")
    panels[0, 0].legend(fontsize=8, frameon=False, loc="upper left")
    panels[1, 0].set_xlabel("t [s]")
    panels[1, 1].set_xlabel("e$_x$ [µm]")
    figure.supylabel("vertical acceleration of the rocker [m/s$^2$]", fontsize=10)
    return figure


def restitution() -> Figure:
    """Restitution that a law realizes in a free impact, against the one that it is given."""
    figure, panel = plt.subplots(figsize=(5.4, 3.6), layout="constrained")
    given = np.linspace(0.1, 0.999, 120)
    laws = (
        sj.ExactRestitution,
        sj.HuntCrossley,
        sj.LankaraniNikravesh,
        sj.Gonthier,
        sj.Flores,
    )
    for law, color, dashes in zip(
        laws, LINES, ((), (4, 1), (1, 1), (6, 1, 1, 1), (2, 1)), strict=True
    ):
        realized = [
            _realized(float(law(restitution=c).hysteresis_factor())) for c in given
        ]
        panel.plot(
            given,
            realized,
            color=color,
            dashes=dashes or (None, None),
            label=law.__name__,
        )
    panel.set(
        xlabel="restitution that is given",
        ylabel="restitution of a free impact",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    panel.legend(fontsize=8)
    return figure


def _realized(chi: float) -> float:
    return brentq(
        lambda e: chi * (1 + e) - np.log((1 + chi) / (1 - chi * e)),
        1e-9,
        min(1.0, 1 / chi) - 1e-12,
    )


def friction() -> Figure:
    """Friction coefficients against sliding speed."""
    figure, panel = plt.subplots(figsize=(5.4, 3.4), layout="constrained")
    speeds = np.linspace(0.0, 4e-3, 400)
    laws = (
        sj.Threlfall(),
        sj.BengisuAkay(),
        sj.Ambrosio(),
        sj.BrownMcPhee(),
        sj.LuGre(),
    )
    for law, color, dashes in zip(
        laws, LINES, ((), (4, 1), (1, 1), (6, 1, 1, 1), (2, 1)), strict=True
    ):
        mu = [float(law.coefficient(v)) for v in speeds]
        panel.plot(
            1e3 * speeds,
            mu,
            color=color,
            dashes=dashes or (None, None),
            label=type(law).__name__,
        )
    panel.set(
        xlabel="sliding speed [mm/s]",
        ylabel="friction coefficient",
        xlim=(0, 4),
        ylim=(0, None),
    )
    panel.legend(fontsize=8)
    return figure


def suspension() -> Figure:
    """The paper's second mechanism over its bump."""
    ts = jnp.linspace(2.9, 4.4, 1501)
    ts = jnp.concatenate([jnp.zeros(1), ts])
    run = sj.simulate(sj.gallery.suspension(sj.Ideal()), ts)
    figure, panels = plt.subplots(
        2, 1, figsize=(6.4, 4.2), sharex=True, layout="constrained"
    )
    panels[0].plot(
        ts[1:],
        1e3 * (run.position("wheel")[1:, 2] - run.position("wheel")[1, 2]),
        color=LINES[1],
    )
    panels[0].set_ylabel("travel of the wheel [mm]")
    force = jnp.linalg.norm(run.reaction("wheel_a_arm"), axis=1)
    panels[1].plot(ts[1:], 1e-3 * force[1:], color=LINES[2])
    panels[1].set(xlabel="t [s]", ylabel="force in the joint [kN]")
    panels[1].margins(x=0)
    return figure


def wear() -> Figure:
    """Wear of a cup of polyethylene over a million steps of walking."""
    cup = sj.HuntCrossley(restitution=0.5, stiffness=1.2e10)
    joint = sj.Dry(clearance=1e-4, socket_radius=0.014, normal=cup)
    run = sj.simulate(sj.gallery.hip(joint), jnp.linspace(0.0, 2.0, 201))
    liner = 0.8e9 * 0.54 / (1.46 * 0.08 * 8e-3)
    options = {"cycles": 3e5, "window": (1.0, 2.0), "foundation": liner}
    return sj.wear(run, "cup", k_socket=1e-15, k_ball=0.0, **options).figure()


def scene(name: str) -> Callable[[], Figure]:
    """A picture of a scene of the gallery, assembled at its start."""
    return lambda: sj.draw(getattr(sj.gallery, name)())


PICTURES: dict[str, Callable[[], Figure]] = {
    "four_bar": four_bar,
    "accelerations": accelerations,
    "orbits": orbits,
    "films": films,
    "restitution": restitution,
    "friction": friction,
    "suspension_over_bump": suspension,
    "wear": wear,
    **{f"scene_{name}": scene(name) for name in sj.gallery.__all__},
}


def save(name: str, figure: Figure) -> None:
    """Write a picture with few colors, which is a third of its size."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=110, facecolor="white")
    plt.close(figure)
    Image.open(buffer).convert("RGB").quantize(96).save(
        FOLDER / f"{name}.png", optimize=True
    )


def main(names: list[str]) -> None:
    """Make the pictures named, or all."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or PICTURES:
        save(name, PICTURES[name]())
        print(f"{name}.png, {(FOLDER / f'{name}.png').stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
