"""Makes the pictures of the documentation, in docs/pictures: `python docs/pictures.py [NAME ...]`, a few minutes."""

import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib

import spherejax as sj
from spherejax.physics.joints.contact import stiffness_of

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
    "dry with friction": sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1)),
    "lubricated": sj.Lubricated(clearance=1e-4, viscosity=0.4),
    "bushing": sj.Bushing(stiffness=1e6, damping=1e-3),
}
COLORS = dict(zip(MODELS, sj.plot.MODEL_COLORS.values(), strict=True))
"""Of the joint models, as in all figures of the library."""

LINES = ("black", "#0a7d91", "#8f1f7e", "#c8791a", "#4a7c2a")


def four_bar() -> Figure:
    """The four-bar with its dry joint magnified."""
    run = sj.simulate(
        sj.gallery.four_bar(MODELS["dry with friction"]), jnp.linspace(0.0, 0.2, 2001)
    )
    return sj.draw(run, t=0.15)


def accelerations() -> Figure:
    """What the joint's model does to the acceleration of the rocker."""
    ts = jnp.linspace(0.0, 0.2, 4001)
    figure, panels = plt.subplots(
        len(MODELS), 1, figsize=(7, 7), sharex=True, layout="constrained"
    )
    for panel, (name, model) in zip(panels, MODELS.items(), strict=True):
        run = sj.simulate(sj.gallery.four_bar(model), ts, rtol=1e-7)
        acceleration = run.acceleration("rocker")[:, 2]
        panel.plot(1e3 * ts, acceleration, color=COLORS[name], linewidth=0.8)
        panel.set_title(name, loc="left", fontsize=9)
        panel.margins(x=0)
    figure.supylabel("vertical acceleration of the rocker [m/s$^2$]", fontsize=10)
    panels[-1].set_xlabel("t [ms]")
    return figure


def orbits() -> Figure:
    """The ball's path in its clearance."""
    ts = jnp.linspace(0.0, 0.2, 4001)
    names = ("dry", "dry with friction", "lubricated")
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
        panel.plot(e[:, 0], e[:, 2], color=COLORS[name], linewidth=0.7)
        panel.set(aspect="equal", title=name, xlabel="e$_x$ [µm]")
    panels[0].set_ylabel("e$_z$ [µm]")
    return figure


def films() -> Figure:
    """The four-bar on the paper's film and on the full one: acceleration of the rocker, path of the ball."""
    ts = jnp.linspace(0.0, 2.0, 2001)
    kinds = {"the paper's film": sj.laws.RadialFilm(), "full film": sj.laws.FullFilm()}
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
        panels, kinds.items(), ("#56B4E9", COLORS["lubricated"]), strict=True
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


def conformity() -> Figure:
    """Load against penetration over clearance, for metal and for a plastic liner."""
    figure, panels = plt.subplots(1, 2, figsize=(7.6, 3.4), layout="constrained")
    plastic = sj.Material(0.8e9, 0.46)
    sockets = (
        (
            "steel on steel, R 10 mm, c 0.1 mm",
            sj.Dry(1e-4),
            sj.laws.SphericalProfile(),
        ),
        (
            "5 mm of polyethylene on metal, R 16 mm",
            sj.Dry(1e-4, socket_radius=0.016, socket_material=plastic),
            sj.laws.WinklerLiner(
                youngs_modulus=0.8e9, poissons_ratio=0.46, thickness=5e-3
            ),
        ),
    )
    ratios = np.linspace(0.0, 1.0, 201)
    for panel, (title, model, law) in zip(panels, sockets, strict=True):
        pressed = sj.Dry(
            model.clearance,
            socket_radius=model.socket_radius,
            socket_material=model.socket_material,
            conformity=law,
        )
        for one, color, dashes, label in (
            (pressed, LINES[0], (None, None), type(law).__name__),
            (model, LINES[1], (4, 1), "Hertz with Eq. 24"),
        ):
            stiffness = stiffness_of(one.normal, one.surfaces)
            force = [
                float(one.normal.elastic_force(1e-4 * ratio, stiffness))
                for ratio in ratios
            ]
            panel.plot(
                ratios, np.array(force) / 1e3, color=color, dashes=dashes, label=label
            )
        panel.axvspan(0.0, 0.1, color="0.93", zorder=0)
        panel.set_title(title, fontsize=8.5, loc="left")
        panel.set(xlabel="penetration / clearance", xlim=(0, 1))
        panel.set_ylim(bottom=0)
        panel.legend(fontsize=8, frameon=False)
    panels[0].set_ylabel("load [kN]")
    return figure


ROSS_WARMTH = (
    (
        12.53,
        13.17,
        13.67,
        14.06,
        14.38,
        14.63,
        14.83,
        15.0,
        15.15,
        15.28,
        15.4,
        15.5,
        15.59,
        15.68,
        15.77,
        15.85,
        15.94,
        16.02,
        16.11,
        16.2,
        16.3,
    ),
    (
        6.27,
        6.49,
        6.73,
        6.99,
        7.28,
        7.62,
        8.03,
        8.51,
        9.08,
        9.76,
        10.56,
        11.48,
        12.51,
        13.67,
        14.92,
        16.23,
        17.52,
        18.74,
        19.82,
        20.7,
        21.4,
    ),
)
"""Rise above the inlet [K] in the middle of both pads, upper one first, at 21 places each: `tm` of ROSS's
tests/data/fluid_film/fixed_adiabatic.json (github.com/petrobras/ross)."""

ROSS_PRESSURE = (
    0.0,
    0.175,
    0.35,
    0.534,
    0.737,
    0.969,
    1.237,
    1.545,
    1.888,
    2.246,
    2.573,
    2.793,
    2.802,
    2.508,
    1.9,
    1.115,
    0.404,
    0.0,
    0.0,
    0.0,
    0.0,
)
"""Of the lower pad, `pc` [MPa]."""


def bearing_heat() -> Figure:
    """Temperature, pressure and filled share of the gap round ROSS's bearing, unrolled from groove to groove."""
    radius, length, clearance, speed, n = 0.2, 0.263144, 1.94564e-4, 94.24778, 32
    load, inlet, capacity = 112814.9, 323.0, 854.9516 * 1951.5015
    beta = np.log(0.01901574 / 0.007715233) / 30.0
    film = sj.laws.LinedBearing(
        length,
        sj.laws.WinklerLiner(2e13, 0.3, 1e-3),
        n,
        grooves=2,
        groove_angle=np.pi / 2,
        groove_width=np.radians(4.0),
    )
    heat = sj.laws.BearingHeat(
        sj.laws.ReynoldsViscosity(beta, 322.98333),
        capacity,
        inlet_temperature=inlet,
        start_temperature=336.0,
    )
    model = sj.Lubricated(
        clearance,
        0.01901574,
        socket_radius=radius,
        film=film,
        conformity=sj.laws.JohnsonCylinder(length),
        heat=heat,
        e_h0=0.0,
        e_h1=0.0,
    )
    scene = sj.gallery.journal_bearing(model, load=load, speed=speed)
    run = sj.simulate(scene, [0.0, 0.5, 1.0], rtol=1e-6, throw=True)
    memory = run.memory("bearing")
    rise = np.array([memory[f"oil_warming_{i}"][-1] for i in range(n)]) + 336.0 - inlet
    w = np.array([memory[f"deflection_{i}"][-1] for i in range(n)])
    pressure = np.maximum(w, 0.0) * float(film.liner.foundation()) / 1e6
    # The first point lies at the groove to the left, before the lower pad.
    places = np.arange(n) * 360.0 / n
    e = np.asarray(run.eccentricity("bearing"))[-1] / clearance
    world = np.radians(180.0 + places)
    gap = 1.0 - e[0] * np.cos(world) - e[1] * np.sin(world)
    # Oil at a point is the mean of what arrives and what leaves, half a step on; a groove fills the gap.
    missing = 0.4 * np.minimum(w, 0.0) / clearance
    oil = 1.0 + (missing + np.roll(missing, 1)) / gap
    filled = np.where((w < 0.0) & (places % 180.0 > 0.0), oil, 1.0)
    pads = 2.0 + np.linspace(0.0, 176.0, 21)
    figure, panels = plt.subplots(1, 3, figsize=(9.2, 3.0), layout="constrained")
    ours, dots = LINES[1], {"linestyle": "", "marker": ".", "color": "0.35"}
    half = 180.0 / n
    for k in range(2):
        own = slice(k * n // 2, (k + 1) * n // 2)
        panels[0].plot(
            places[own] + half,
            rise[own],
            color=ours,
            label="BearingHeat, 32 points" if k == 0 else None,
        )
        panels[0].plot(
            180.0 * k + pads,
            ROSS_WARMTH[1 - k],
            label="ROSS" if k == 0 else None,
            **dots,
        )
    panels[1].plot(places, pressure, color=ours)
    panels[1].plot(pads, ROSS_PRESSURE, **dots)
    panels[2].plot(places, 100.0 * filled, color=ours)
    names = (
        "oil above the inlet [K]",
        "pressure in the middle [MPa]",
        "filled share of the gap [%]",
    )
    for panel, name in zip(panels, names, strict=True):
        for groove in (0.0, 180.0, 360.0):
            panel.axvline(groove, color="0.8", linewidth=3.0, zorder=0)
        panel.set(
            xlabel="angle from the first groove [°]",
            ylabel=name,
            xlim=(0, 360),
            xticks=range(0, 361, 90),
        )
        panel.set_ylim(bottom=0)
    panels[2].set_ylim(0, 105)
    panels[0].legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def piston() -> Figure:
    """What play in the pin of a piston does to the motor, and the journal's path."""
    ts = jnp.linspace(0.0, 0.012, 2401)
    contact = sj.laws.JohnsonCylinder(0.02)
    film = sj.laws.ShortBearing(0.02)
    # A bearing as long as its radius, for which that film is.
    wide = {"socket_radius": 0.02, "conformity": contact}
    models = (
        ("ideal", sj.Ideal()),
        ("dry, c = 0.5 mm", sj.Dry(5e-4, **wide)),
        ("lubricated, c = 0.5 mm", sj.Lubricated(5e-4, 0.4, film=film, **wide)),
    )
    figure = plt.figure(figsize=(8.6, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.3, 1))
    angle = np.degrees(np.asarray(ts) * 5000 * 2 * np.pi / 60)
    around = np.linspace(0, 2 * np.pi, 200)
    right.plot(0.5 * np.cos(around), 0.5 * np.sin(around), color="0.6", linewidth=0.8)
    dry, oil = COLORS["dry"], COLORS["lubricated"]
    styles = ((COLORS["ideal"], 1.4, 3), (dry, 0.7, 1), (oil, 1.2, 2))
    for (name, model), (color, width, order) in zip(models, styles, strict=True):
        run = sj.simulate(sj.gallery.piston(model), ts)
        moment = np.asarray(run.driving_effort("motor"))
        dashes = (4, 2) if name == "ideal" else (None, None)
        left.plot(
            angle,
            moment,
            color=color,
            linewidth=width,
            dashes=dashes,
            zorder=order,
            label=name,
        )
        if name != "ideal":
            e = 1e3 * np.asarray(run.eccentricity("pin"))
            right.plot(e[:, 0], e[:, 2], color=color, linewidth=0.9)
    left.set(
        xlabel="crank angle [deg]", ylabel="moment of the motor [N m]", xlim=(0, 360)
    )
    left.set_xticks(range(0, 361, 60))
    left.legend(fontsize=8, frameon=False, loc="lower right")
    right.set(aspect="equal", xlabel="e$_x$ [mm]", ylabel="e$_z$ [mm]")
    right.set_title("journal in its bearing", fontsize=9, loc="left")
    return figure


def tilting() -> Figure:
    """A shaft that hangs out of its bearing falls, tilts to both rims and comes to rest on its lever."""
    ts = jnp.linspace(0.0, 0.12, 2401)
    model = sj.Dry(
        2e-4,
        normal=sj.LankaraniNikravesh(0.5, stiffness=1e9),
        friction=sj.Threlfall(0.1),
    )
    rotor = sj.Body(0.5, (1e-4, 2e-4, 2e-4), (0.05, 0, 0), angular_velocity=(50, 0, 0))
    bearing = sj.joints.tilting_journal(
        "shaft", ("ground", "rotor"), (0, 0, 0), (1, 0, 0), model, length=0.04
    )
    run = sj.simulate(sj.Scene({"rotor": rotor}, bearing), ts)
    figure = plt.figure(figsize=(8.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.3, 1))
    around = np.linspace(0, 2 * np.pi, 200)
    right.plot(0.2 * np.cos(around), 0.2 * np.sin(around), color="0.6", linewidth=0.8)
    rims = (("shaft_1", "far rim"), ("shaft_2", "rim at the overhang"))
    for (name, words), color in zip(rims, LINES[1:3], strict=True):
        e = 1e3 * np.asarray(run.eccentricity(name))
        left.plot(
            1e3 * np.asarray(ts), e[:, 2], color=color, linewidth=1.0, label=words
        )
        right.plot(e[:, 1], e[:, 2], color=color, linewidth=0.8)
    for side in (-0.2, 0.2):
        left.axhline(side, color="0.6", linewidth=0.8)
    left.set(xlabel="t [ms]", ylabel="e$_z$ [mm]", xlim=(0, 120))
    left.legend(fontsize=8, frameon=False, loc="center right")
    right.set(aspect="equal", xlabel="e$_y$ [mm]", ylabel="e$_z$ [mm]")
    right.set_title("shaft in its bearing", fontsize=9, loc="left")
    return figure


def lined_bearing() -> Figure:
    """A journal whose load grows, on liners of three stiffnesses: place, and pressure round the bearing at the end."""
    radius, length, clearance, viscosity, speed = 0.02, 0.02, 1e-4, 0.05, 300.0
    full = 500.0
    liners = {
        "steel, 2 mm": sj.laws.WinklerLiner(2e11, 0.3, 2e-3),
        "polymer, 1 GPa, 2 mm": sj.laws.WinklerLiner(1e9, 0.4, 2e-3),
        "rubber, 50 MPa, 2 mm": sj.laws.WinklerLiner(5e7, 0.45, 2e-3),
    }
    ts = np.linspace(0.0, 4.0, 161)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.4), layout="constrained")
    for (name, liner), color in zip(liners.items(), LINES[1:4], strict=True):
        model = sj.Lubricated(
            clearance,
            viscosity,
            socket_radius=radius,
            film=sj.laws.LinedBearing(length, liner),
            conformity=sj.laws.JohnsonCylinder(length),
            e_h0=0.0,
            e_h1=0.0,
        )
        shaft = sj.Body(1.0, (1e-4, 1e-4, 1e-4), angular_velocity=(0, 0, speed))
        motor = sj.RotationDriver(
            ("ground", "shaft"), (0, 0, 1), sj.functions.Linear(speed)
        )
        bearing = sj.Revolute(("ground", "shaft"), (0, 0, 0), (0, 0, 1), model)
        push = sj.AppliedWrench(
            "shaft",
            force=lambda t: jnp.stack([0.0 * t, -full * (0.05 + t) / 4.05, 0.0 * t]),
        )
        scene = sj.Scene(
            {"shaft": shaft},
            {"bearing": bearing, "motor": motor},
            {"push": push},
            gravity=(0, 0, 0),
        )
        run = sj.simulate(scene, ts, rtol=1e-6, throw=True)
        e = np.linalg.norm(np.asarray(run.eccentricity("bearing")), axis=1) / clearance
        load = full * (0.05 + ts) / 4.05
        left.plot(load[8:], e[8:], color=color, linewidth=1.4, label=name)
        memory = run.memory("bearing")
        w = np.array([float(memory[f"deflection_{i}"][-1]) for i in range(32)])
        pressure = np.maximum(float(liner.foundation()) * w, 0.0) / 1e6
        axes = np.asarray(run.system.spherical("bearing").frame)
        angles = np.degrees(2 * np.pi * np.arange(32) / 32)
        turn = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
        places = (angles + turn + 90.0 + 180.0) % 360.0 - 180.0
        order = np.argsort(places)
        right.plot(
            places[order],
            pressure[order],
            color=color,
            linewidth=1.4,
            marker=".",
            markersize=4,
        )
    left.set(xlabel="load [N]", ylabel="eccentricity ratio [-]", xlim=(0, full))
    left.set_ylim(0, 1)
    left.legend(fontsize=8, frameon=False, loc="lower right")
    right.set(
        xlabel="place round the bearing, from the load [°]",
        ylabel="pressure in the middle [MPa]",
        xlim=(-180, 180),
        xticks=range(-180, 181, 60),
    )
    right.set_ylim(bottom=0)
    right.set_title(f"at {full:.0f} N", fontsize=9, loc="left")
    return figure


def lined_socket() -> Figure:
    """A hip in polyethylene over two steps: load and film, and the pressure in the cup at the largest load."""
    radius, clearance = 14e-3, 8e-5
    liner = sj.laws.WinklerLiner(1e9, 0.4, 8e-3)
    ts = np.linspace(0.0, 2.0, 201)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.4), layout="constrained")
    load = left.twinx()
    for viscosity, color in zip((2e-3, 5e-3, 1e-2), LINES[1:4], strict=True):
        film = sj.laws.LinedSocket(liner)
        model = sj.Lubricated(clearance, viscosity, socket_radius=radius, film=film)
        run = sj.simulate(sj.gallery.hip(model), ts, rtol=1e-4, throw=True)
        thickness = 1e6 * np.asarray(run.part("cup", "film_thickness"))
        left.plot(
            ts[1:], thickness[1:], color=color, label=f"{1e3 * viscosity:.0f} mPa s"
        )
    force = np.linalg.norm(np.asarray(run.reaction("cup")), axis=1) / 1e3
    load.fill_between(ts[1:], force[1:], color="0.5", alpha=0.2, linewidth=0)
    peak = int(np.argmax(force[100:])) + 100
    memory = run.memory("cup")
    w = np.array(
        [float(memory[f"deflection_{i}"][peak]) for i in range(len(film.memory))]
    )
    pressure = np.maximum(w, 0.0).reshape(film.rings, film.around) * float(
        liner.foundation()
    )
    angles = 90.0 / film.rings * (np.arange(film.rings) + 0.5)
    e = np.linalg.norm(np.asarray(run.eccentricity("cup"))[peak])
    fine = np.linspace(0.0, 90.0, 181)
    dry = float(liner.foundation()) * np.maximum(
        e * np.cos(np.radians(fine)) - clearance, 0.0
    )
    right.plot(fine, dry / 1e6, color="0.6", linewidth=3, label="dry columns")
    right.plot(
        np.repeat(angles, film.around),
        pressure.ravel() / 1e6,
        ".",
        color=LINES[3],
        markersize=4,
        label="cells of the film",
    )
    left.set(xlabel="time [s]", ylabel="least film thickness [µm]", xlim=(0, 2))
    left.set_ylim(0, 1.5)
    left.set_zorder(load.get_zorder() + 1)
    left.patch.set_visible(False)
    left.legend(fontsize=8, frameon=False, loc="upper right")
    load.set(ylabel="load, gray [kN]", ylim=(0, 6))
    right.set(
        xlabel="angle from the middle of the cup [°]",
        ylabel="pressure [MPa]",
        xlim=(0, 90),
        xticks=range(0, 91, 15),
    )
    right.set_ylim(bottom=0)
    right.legend(fontsize=8, frameon=False, loc="upper right")
    right.set_title(f"at {1e3 * force[peak]:.0f} N", fontsize=9, loc="left")
    return figure


def thickening() -> Figure:
    """Load by eccentricity ratio, and pressure round a short bearing, for three coefficients of pressure."""
    radius, length, clearance, viscosity, speed = 0.02, 0.02, 1e-4, 0.05, 300.0
    film = sj.laws.ShortBearing(length)
    gap = sj.laws.FilmGap(clearance, radius, viscosity, 0.0, sj.Guembel())
    axis = jnp.array([0.0, 0.0, 1.0])

    def motion(eps):
        return sj.laws.FilmMotion(
            eps * clearance * jnp.array([1.0, 0.0, 0.0]),
            jnp.zeros(3),
            jnp.zeros(3),
            speed * axis,
            axis,
        )

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.4), layout="constrained")
    ratios = jnp.linspace(0.02, 0.8, 79)
    angles = np.linspace(-np.pi, np.pi, 721)
    swept = -speed / 2 * 0.8 * clearance
    thickness = clearance * (1 - 0.8 * np.cos(angles))
    reduced = 1.5 * viscosity * length**2 * np.maximum(swept * np.sin(angles), 0)
    reduced = reduced / thickness**3
    for alpha, color in zip((0.0, 5e-8, 1e-7), LINES[1:4], strict=True):
        law = sj.laws.BarusThickening(alpha) if alpha else None
        loads = jax.jit(
            jax.vmap(
                lambda eps, law=law: jnp.linalg.norm(
                    film.action(motion(eps), gap._replace(thickening=law)).force
                )
            )
        )(ratios)
        pressure = -np.log1p(-alpha * reduced) / alpha if alpha else reduced
        name = f"{1e9 * alpha:.0f} per GPa" if alpha else "constant viscosity"
        left.plot(ratios, loads, color=color, linewidth=1.4, label=name)
        right.plot(np.degrees(angles), pressure / 1e6, color=color, linewidth=1.4)
    left.set(xlabel="eccentricity ratio [-]", ylabel="load [N]", xlim=(0, 0.8))
    left.set_ylim(bottom=0)
    left.legend(fontsize=8, frameon=False, loc="upper left")
    right.set(
        xlabel="place round the bearing, from the smallest gap [°]",
        ylabel="pressure in the middle [MPa]",
        xlim=(-90, 30),
    )
    right.set_ylim(bottom=0)
    right.set_title("at an eccentricity ratio of 0.8", fontsize=9, loc="left")
    return figure


def warm_oil() -> Figure:
    """A loaded journal whose oil stays cold, warms, or warms and is cooled; and where the balance of heat ends."""
    radius, length, clearance, viscosity, speed, load = (
        0.02,
        0.02,
        1e-4,
        0.1,
        300.0,
        300.0,
    )
    beta, conductance, cold = 0.03, 4.0, 313.15
    reynolds = sj.laws.ReynoldsViscosity(beta)
    heats = {
        "constant viscosity": None,
        "all heat in the oil": sj.laws.OilHeat(reynolds, 5.0),
        "4 W/K to the bodies": sj.laws.OilHeat(reynolds, 5.0, 3.0, 1.0),
    }

    def sommerfeld(eps):
        return eps / (1 - eps**2) ** 2 * np.sqrt(16 * eps**2 + np.pi**2 * (1 - eps**2))

    def at(kelvins):
        """Ocvirk's eccentricity ratio, and the couple by which the film brakes the journal."""
        nu = viscosity * np.exp(-beta * (kelvins - cold))
        scale = nu * speed * radius * length**3 / (4 * clearance**2)
        eps = brentq(lambda eps: scale * sommerfeld(eps) - load, 1e-6, 0.999)
        side = np.sin(np.arctan2(np.pi * np.sqrt(1 - eps**2), 4 * eps))
        petroff = 2 * np.pi * nu * speed * length * radius**3 / clearance
        return eps, petroff / np.sqrt(1 - eps**2) + clearance * eps * load * side / 2

    def excess(kelvins):
        return speed * at(kelvins)[1] - conductance * (kelvins - cold)

    steady = brentq(excess, cold, 400.0)
    ts = np.linspace(0.0, 8.0, 401)
    figure, panels = plt.subplots(1, 3, figsize=(9.2, 3.0), layout="constrained")
    for (name, heat), color in zip(heats.items(), LINES[1:4], strict=True):
        model = sj.Lubricated(
            clearance,
            viscosity,
            socket_radius=radius,
            film=sj.laws.ShortBearing(length),
            conformity=sj.laws.JohnsonCylinder(length),
            heat=heat,
            e_h0=0.0,
            e_h1=0.0,
        )
        scene = sj.gallery.journal_bearing(model, load=load, speed=speed)
        run = sj.simulate(scene, ts, rtol=1e-6)
        warm = (
            np.full(ts.shape, cold)
            if heat is None
            else np.asarray(run.part("bearing", "oil_temperature"))
        )
        e = np.linalg.norm(np.asarray(run.eccentricity("bearing")), axis=1) / clearance
        couple = -np.asarray(run.part("bearing", "film_moment"))[:, 2]
        for panel, values in zip(panels, (warm - 273.15, couple, e), strict=True):
            panel.plot(ts[1:], values[1:], color=color, linewidth=1.2, label=name)
    eps, couple = at(steady)
    for panel, value in zip(panels, (steady - 273.15, couple, eps), strict=True):
        panel.axhline(value, color="black", linewidth=0.8, dashes=(4, 3))
        panel.set(xlabel="t [s]", xlim=(0, ts[-1]))
    panels[0].set_ylabel("temperature of the oil [°C]")
    panels[1].set_ylabel("couple of the film [N m]")
    panels[1].set_ylim(bottom=0)
    panels[2].set_ylabel("eccentricity ratio [-]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, fontsize=8, frameon=False, ncols=3, loc="outside upper center"
    )
    return figure


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


def joint_friction() -> Figure:
    """What the pressure in an ideal joint with friction does to a pendulum, and to a ball that spins under a weight."""
    figure, panels = plt.subplots(1, 2, figsize=(7.2, 3.1), layout="constrained")
    law, radius = sj.Threlfall(mu=0.2, v1=1e-4), 0.012
    pressures = {
        "point": sj.laws.PointContact(),
        "cosine": sj.laws.CosinePressure(),
        "uniform": sj.laws.UniformPressure(),
    }
    rod = sj.Body(0.5, (1e-4, 4e-3, 4e-3), position=(0.15, 0.0, 0.0))
    ball = sj.Body(
        0.5,
        (2e-4,) * 3,
        angular_velocity=(0.0, 0.0, 20.0),
        points={"center": (0.0, 0.0, 0.0)},
    )
    for (name, pressure), color in zip(pressures.items(), LINES, strict=False):
        model = sj.Ideal(law, radius, pressure)
        pivot = sj.Revolute(("ground", "rod"), (0, 0, 0), (0, 1, 0), model)
        ts = jnp.linspace(0.0, 12.0, 1201)
        run = sj.simulate(sj.Scene({"rod": rod}, {"pivot": pivot}), ts)
        place = run.position("rod")
        angle = np.rad2deg(np.arctan2(place[:, 0], -place[:, 2]))
        panels[0].plot(ts, angle, color=color, linewidth=0.9, label=name)
        joint = sj.Spherical("ground.socket", "ball.center", model)
        scene = sj.Scene(
            {"ball": ball}, {"joint": joint}, ground_points={"socket": (0, 0, 0)}
        )
        ts = jnp.linspace(0.0, 0.5, 101)
        spin = sj.simulate(scene, ts).angular_velocity("ball")[:, 2]
        panels[1].plot(ts, spin, color=color, label=name)
    panels[0].set(xlabel="t [s]", ylabel="angle of a pendulum [deg]", xlim=(0, 12))
    panels[1].set(xlabel="t [s]", ylabel="spin of a ball [rad/s]", xlim=(0, 0.5))
    panels[1].set_ylim(0, None)
    for panel in panels:
        panel.legend(fontsize=8, title="pressure", title_fontsize=8)
    return figure


def rubber() -> Figure:
    """Dynamic stiffness of rubber at two amplitudes, beside a spring with a damper."""
    frequencies = np.geomspace(0.5, 200.0, 121)
    law = sj.laws.VectorElastomer(2e5, 0.0)
    branches = sj.laws.Maxwell([6e4, 5e4, 6e4], [0.1, 0.01, 0.001])
    bushings = {
        "rubber": (
            sj.Bushing(law=law, branches=branches, friction=sj.laws.Berg(40.0, 1e-4)),
            [5e-5, 1e-3],
        ),
        "Kelvin-Voigt, b = 10 ms": (
            sj.Bushing(law=sj.laws.VectorElastomer(2e5, 1e-2)),
            [1e-3],
        ),
    }
    tables = {
        name: sj.studies.dynamic_stiffness(bushing, frequencies, amplitudes).to_xarray()
        for name, (bushing, amplitudes) in bushings.items()
    }
    return sj.plot.dynamic_stiffness(tables, "Rubber, and a spring with a damper")


def controllers() -> Figure:
    """An arm that a motor lifts, under control in continuous time and in samples."""
    turn = sj.Turn(("ground", "arm"), axis=(0, 1, 0))
    wanted = sj.functions.SmoothStep(0.0, 0.4, 0.0, -np.pi / 2)
    gains = dict(
        proportional=60.0, integral=80.0, derivative=8.0, filter_time=5e-3, limits=(-20, 20), tracking_time=0.1
    )  # fmt: skip
    motors = {
        "continuous": sj.PID(turn, wanted, **gains),
        "every 20 ms": sj.forces.SampledPID(turn, 0.02, wanted, **gains),
        "every 50 ms": sj.forces.SampledPID(turn, 0.05, wanted, **gains),
    }
    body = sj.Body(2.0, (0.05, 0.05, 0.01), position=(0.0, 0.0, -0.3))
    hinge = sj.Revolute(("ground", "arm"), point=(0, 0, 0), axis=(0, 1, 0))
    ts = jnp.linspace(0.0, 1.5, 1501)
    figure, (angle, torque) = plt.subplots(
        2, 1, figsize=(7, 5), sharex=True, layout="constrained"
    )
    for (name, motor), color in zip(motors.items(), LINES, strict=False):
        scene = sj.Scene({"arm": body}, {"hinge": hinge}, {"motor": motor})
        seen = sj.simulate(scene, ts).force("motor")
        angle.plot(ts, -np.degrees(seen["position"]), color=color, label=name)
        torque.plot(ts, -seen["effort"], color=color, linewidth=1.0)
    angle.plot(ts, -np.degrees(seen["reference"]), "--", color="0.5", label="reference")
    angle.set_ylabel("angle of the arm [deg]")
    torque.set_ylabel("torque [N m]")
    torque.set_xlabel("t [s]")
    angle.legend(frameon=False)
    for panel in (angle, torque):
        panel.margins(x=0)
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


def rig_joints() -> dict[str, dict]:
    """What the joints of the double wishbone may be."""
    law = sj.laws.MatrixElastomer.cylindrical(
        (0.0, 0.0, 1.0),
        radial_stiffness=8e6,
        axial_stiffness=1e6,
        conical_stiffness=500.0,
        torsional_stiffness=50.0,
        damping=1e-4,
    )
    worn = sj.Dry(2e-4)
    return {
        "ideal": {},
        "rubber bushes": {"bushes": sj.Bushing(law=law)},
        "ball joints with play": {"ball_joint": worn},
        "tie rod with play": {"tie_rod_joint": worn},
    }


def rig() -> Figure:
    """Curves of the double wishbone over travel."""
    travel = np.linspace(-0.08, 0.08, 33)
    found = sj.vehicle.rig(sj.gallery.double_wishbone(), travel)
    return sj.plot.rig(found.to_xarray(), title="A double wishbone on the rig")


def rig_toe() -> Figure:
    """What each model of its joints does to toe, over travel and over the lateral force."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(8.4, 3.8), layout="constrained", sharey=True
    )
    travel, lateral = np.linspace(-0.06, 0.06, 25), np.linspace(-3000.0, 3000.0, 31)
    cornering = sj.vehicle.WheelLoads(lateral=-2000.0)
    for (name, model), color, dashes in zip(
        rig_joints().items(), LINES, ((), (4, 1), (1, 1), (6, 1, 1, 1)), strict=False
    ):
        scene = sj.gallery.double_wishbone(**model)
        look = {"color": color, "dashes": dashes or (None, None)}
        over_travel = sj.vehicle.rig(scene, travel, loads=cornering)
        left.plot(1e3 * travel, np.degrees(over_travel.toe), label=name, **look)
        by_force = sj.vehicle.rig(
            scene, 0.0, loads=sj.vehicle.WheelLoads(lateral=lateral)
        )
        right.plot(1e-3 * lateral, np.degrees(by_force.toe), **look)
    left.set(xlabel="travel [mm], under -2 kN", ylabel="toe-in [deg]")
    right.set(xlabel="lateral force [kN] at the design height")
    for panel in (left, right):
        panel.margins(x=0)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def report() -> Image.Image:
    """The head of a report in Chromium, in the middle of the motion."""
    sys.path.insert(0, str(FOLDER.parents[1] / "tests"))
    import browsing

    joint = MODELS["dry with friction"]
    scene = sj.gallery.four_bar(joint)
    run = sj.simulate(scene, jnp.linspace(0.0, 0.2, 401))
    with TemporaryDirectory() as folder, browsing.chromium() as driver:
        page = run.report(
            Path(folder) / "run.html",
            scene=scene,
            title="Four-bar with 0.1 mm of play",
        )
        browsing.set_size(driver, 900, 800)
        driver.get(page.as_uri())
        driver.execute_script(
            "const v = document.querySelector('.motion').viewer;"
            "v.slider.value = 0.6; v.show(0.6);"
        )
        return Image.open(BytesIO(driver.get_screenshot_as_png()))


def wear() -> Figure:
    """Wear of a cup of polyethylene over a million steps of walking."""
    cup = sj.HuntCrossley(restitution=0.5, stiffness=1.2e10)
    joint = sj.Dry(clearance=1e-4, socket_radius=0.014, normal=cup)
    run = sj.simulate(sj.gallery.hip(joint), jnp.linspace(0.0, 2.0, 201))
    liner = 0.8e9 * 0.54 / (1.46 * 0.08 * 8e-3)
    options = {"cycles": 3e5, "window": (1.0, 2.0), "foundation": liner}
    return sj.wear(run, "cup", k_socket=1e-15, k_ball=0.0, **options).figure()


def wear_in() -> Figure:
    """Wear with a motion that follows, and with the motion of the unworn joint."""
    rate, clearance = 30.0, 1e-4
    law = sj.laws.HuntCrossleyDissipation(30.0, stiffness=1.5e11)
    dry = sj.Dry(clearance, socket_radius=0.01, normal=law)
    ball = sj.Body(
        1.0,
        (1e-3,) * 3,
        position=(0, 0, -1.012e-4),
        angular_velocity=(0, rate, 0),
        points={"center": (0, 0, 0)},
    )
    joint = sj.Spherical("ground.socket", "ball.center", dry, starts_concentric=False)
    spring = sj.SpringDamper(("ground.anchor", "ball.center"), 2e6, 300.0, 0.9997988)
    pressed = sj.Scene(
        {"ball": ball},
        {"joint": joint},
        {"spring": spring},
        gravity=(0, 0, 0),
        ground_points={"socket": (0, 0, 0), "anchor": (0, 0, -1.0)},
    )
    turn = 2 * np.pi / rate
    ts = np.linspace(0.0, 0.1 + turn, 21)
    options = {"cycles": 4000.0, "window": (0.1, 0.1 + turn), "cells": 64}
    options |= {"k_socket": 1e-13, "k_ball": 0.0, "foundation": 1e12}
    follows = sj.studies.wear_in(pressed, "joint", ts, **options)
    alone = sj.wear(sj.simulate(pressed, ts), "joint", **options)
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(11, 3.4), layout="constrained"
    )
    left.plot(alone.cycles, 1e9 * alone.volumes("socket"), "--", color="0.4")
    left.plot(follows.cycles, 1e9 * follows.volumes("socket"), "o-", ms=3)
    left.set(xlabel="cycles", ylabel="rubbed off [mm³]")
    middle.axhline(
        follows.blocks[0].impulse / turn, ls="--", color="0.4", label="unworn motion"
    )
    loads = [block.impulse / turn for block in follows.blocks]
    middle.plot(follows.cycles, loads, "o-", ms=3, label="motion that follows")
    middle.set(xlabel="cycles", ylabel="load [N]", ylim=(0, None))
    angle = np.radians(np.linspace(-90, 90, 361))
    u = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=-1)
    profile = follows.profile("socket")
    felt = [float(profile.depth(jnp.asarray(each))) for each in u]
    right.plot(
        np.degrees(angle),
        1e6 * follows.wear.depth_at("socket", u),
        label="depth of wear",
    )
    right.plot(
        np.degrees(angle), 1e6 * np.array(felt), label="how much farther the ball goes"
    )
    right.set(xlabel="direction, across the axis [deg]", ylabel="in the end [µm]")
    right.set(ylim=(-2, 62))
    middle.legend(fontsize=8, frameon=False)
    right.legend(fontsize=8, frameon=False, loc="upper center")
    return figure


def scene(name: str) -> Callable[[], Figure]:
    """A picture of a scene of the gallery, assembled at its start."""
    return lambda: sj.draw(getattr(sj.gallery, name)())


def modes() -> Figure:
    """Modes of an arm on rubber, with a weight that hangs from it."""
    place = (0.02, 0.05, -0.1)
    arm = sj.Body(1.0, (1e-2,) * 3, place, points={"pivot": tuple(-x for x in place)})
    rubber = sj.laws.MatrixElastomer.cylindrical(
        (0.0, 1.0, 0.0),
        radial_stiffness=4e3,
        axial_stiffness=3e3,
        conical_stiffness=80.0,
        torsional_stiffness=40.0,
        damping=1e-3,
    )
    axis = (0.1, 1.0, 0.0)
    scene = sj.Scene(
        {"arm": arm, "weight": sj.Body(0.5, (1e-3,) * 3, (0.07, 0.05, -0.28))},
        {
            "mount": sj.Spherical("ground.pivot", "arm.pivot", sj.Bushing(law=rubber)),
            "hinge": sj.Revolute(("arm", "weight"), (0.05, 0.05, -0.2), axis),
        },
        {"coil": sj.TorsionalSpring(("arm", "weight"), axis, 2.0, 0.1)},
        ground_points={"pivot": (0.0, 0.0, 0.0)},
    )
    found = sj.linearize(scene, at="rest").modes()
    return sj.plot.modes(found, title="An arm on rubber: modes at rest")


class Push(eqx.Module):
    """A harmonic force along x."""

    frequency: float

    def __call__(self, t: float) -> jax.Array:
        """At a time."""
        return (
            0.3 * jnp.cos(2 * jnp.pi * self.frequency * t) * jnp.array([1.0, 0.0, 0.0])
        )


def oscillator(frequency: float) -> sj.Scene:
    """Duffing's, as a body on a guide."""
    x = (1.0, 0.0, 0.0)
    cubic = sj.functions.Polynomial([0.0, 0.0, 0.0, 1.0])
    spring = sj.SpringDamper(
        ("ground.wall", "body"), 1.0, 0.2, spring=cubic, direction=x
    )
    return sj.Scene(
        {"body": sj.Body(1.0, (2.0, 2.0, 2.0))},
        {"guide": sj.Prismatic(("ground", "body"), (0.0, 0.0, 0.0), x)},
        {
            "spring": spring,
            "push": sj.AppliedWrench("body", force=Push(frequency)),
        },
        gravity=(0.0, 0.0, 0.0),
        ground_points={"wall": (0.0, 0.0, 0.0)},
    )


def continuation() -> Figure:
    """Duffing's oscillator along the frequency of its force."""
    branch = sj.studies.continuation(
        oscillator,
        "frequency",
        (0.1, 0.3),
        period=lambda f: 1 / f,
        outputs="position.body.x",
        samples=64,
        largest_step=0.05,
    )
    title = "A body on a hardening spring, along the frequency of its force [Hz]"
    return sj.plot.continuation(branch, title=title)


def swept_sine() -> Figure:
    """A damped pendulum under gravity that is shaken sideways."""
    hinge = ("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    scene = sj.Scene(
        {"bob": sj.Body(1.0, (2e-2, 1e-2, 1.5e-2), (0.0, 0.0, -0.5))},
        {"pivot": sj.Revolute(*hinge)},
        {"drag": sj.TorsionalSpring(hinge[0], hinge[2], 0.0, 0.1)},
    )
    found = sj.studies.swept_sine(
        scene,
        "gravity.x",
        "position.bob.x",
        np.linspace(0.4, 1.0, 25),
        [0.1, 1.0, 2.0],
    )
    return sj.plot.swept_sine(found, title="A pendulum whose pivot is shaken")


def inverse_dynamics() -> Figure:
    """What the motors of the leg have to do for a step, with and without the masses of crank and rod."""
    ts = np.linspace(0.0, 2 / 3, 201)
    axis = (0.0, 1.0, 0.0)
    motors = {
        "motor of the thigh": sj.Turn(("ground", "thigh"), axis),
        "motor of the crank": sj.Turn(("ground", "crank"), axis),
    }
    found = sj.inverse_dynamics(sj.gallery.leg(), ts, motors=motors)
    figure, panels = plt.subplots(
        3, 1, figsize=(7, 6.4), sharex=True, layout="constrained"
    )
    for name, color in zip(motors, LINES[1:], strict=False):
        panels[0].plot(ts, found.effort(name), color=color, label=name)
        panels[1].plot(ts, found.power(name), color=color)
    for joint, color in zip(("hip", "knee", "rod_shank"), LINES, strict=False):
        force = np.linalg.norm(found.reaction(joint), axis=1)
        panels[2].plot(ts, force, color=color, label=f"joint {joint}")
    panels[0].set_ylabel("moment [N m]")
    panels[1].set_ylabel("power [W]")
    panels[2].set(ylabel="reaction [N]", xlabel="t [s]")
    for panel in panels:
        panel.margins(x=0)
    for panel in (panels[0], panels[2]):
        panel.legend(
            fontsize=8,
            frameon=False,
            ncols=3,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
        )
    return figure


def gears() -> Figure:
    """The wheel that rattles between the flanks of its pinion, for two strengths of the vibration."""
    ts = jnp.linspace(0.0, 0.2, 4001)
    figure, panels = plt.subplots(
        2,
        2,
        figsize=(8.4, 4.8),
        sharex=True,
        sharey="row",
        layout="constrained",
        height_ratios=(3, 2),
    )
    for (upper, lower), amplitude in zip(panels.T, (0.002, 0.02), strict=True):
        scene = sj.gallery.rattling_gears(amplitude=amplitude, drag=0.02)
        mesh = sj.simulate(scene, ts, rtol=1e-7).force("mesh")
        upper.axhspan(-100, 100, color="0.93", linewidth=0)
        upper.plot(1e3 * ts, 1e6 * mesh["lag"], color=LINES[1], linewidth=1.0)
        lower.plot(1e3 * ts, mesh["force"], color="black", linewidth=0.8)
        upper.set_title(
            f"vibration of {1e3 * amplitude:g} mrad", loc="left", fontsize=9
        )
        lower.set_xlabel("t [ms]")
        upper.margins(x=0)
    panels[0, 0].set_ylabel("lag u [µm]")
    panels[1, 0].set_ylabel("force on the wheel [N]")
    return figure


def pose_play() -> Figure:
    """Where the tip of the five-bar can be within clearances of 0.05 mm, by the bound and by samples."""
    model = sj.Dry(clearance=5e-5, normal=sj.Hertz(stiffness=1e8, exponent=1.0))
    play = sj.studies.pose_play(sj.gallery.five_bar(model), "left_rod.tip")
    rng = np.random.default_rng(0)
    n = 4000
    samples = {}
    for name in play.influence:
        angle = rng.uniform(0.0, 2 * np.pi, n)
        ring = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], 1)
        samples[name] = 5e-5 * np.sqrt(rng.uniform(0.5, 1.0, (n, 1))) * ring
    moved = 1e6 * np.asarray(jax.jit(jax.vmap(play.change))(samples))
    angles = np.linspace(0.0, 2 * np.pi, 181)
    outline = []
    for a in angles:
        d = np.array([np.cos(a), 0.0, np.sin(a), 0.0, 0.0, 0.0])
        worst = play.worst(d)
        outline.append(sum(np.asarray(play.influence[j] @ worst[j]) for j in worst))
    outline = 1e6 * np.array(outline)
    figure, panel = plt.subplots(figsize=(5.4, 5.2), layout="constrained")
    panel.plot(
        moved[:, 0], moved[:, 2], ".", color=LINES[1], markersize=1.5, label="samples"
    )
    panel.plot(
        outline[:, 0], outline[:, 2], color="black", linewidth=1.2, label="bound"
    )
    panel.set(aspect="equal", xlabel="x [µm]", ylabel="z [µm]")
    panel.legend(
        fontsize=8,
        frameon=False,
        ncols=2,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        markerscale=5,
    )
    return figure


def worn_bush() -> Figure:
    """Bush of a slider-crank's pin: its depth along the cycles, and the pin's path in it at first and in the end."""
    clearance, radius, speed = 1e-4, 0.01, 20.0
    law = sj.laws.HuntCrossleyDissipation(30.0, stiffness=2e9, exponent=1.5)
    model = sj.Dry(clearance, socket_radius=radius, normal=law)
    piston = sj.gallery.piston(model, speed=speed)
    load = sj.AppliedWrench("piston", force=(-500.0, 0, 0))
    scene = sj.Scene(piston.bodies, piston.joints, {"load": load})
    cycle = (0.3, 0.3 + 2 * np.pi / speed)
    ts = np.concatenate([[0.0], np.linspace(*cycle, 121)])
    worn = sj.studies.wear_in(
        scene,
        "pin",
        ts,
        k_socket=5e-13,
        k_ball=0.0,
        window=cycle,
        cycles=4000.0,
        length=0.02,
        foundation=1e12,
        rtol=1e-8,
    )
    first = sj.simulate(scene, ts, rtol=1e-8)
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(8.6, 3.6), layout="constrained", width_ratios=(3, 2)
    )
    u = worn.wear.directions
    angles = np.degrees(np.arctan2(u[:, 1], u[:, 0]))
    order = np.argsort(angles)
    for block, cycles in enumerate(worn.cycles[1:], 1):
        shade = plt.get_cmap("viridis_r")(cycles / worn.cycles[-1])
        depth = 1e6 * worn.depth("socket", block)[order]
        left.plot(angles[order], depth, color=shade, label=f"{cycles:.0f} cycles")
    left.set(
        xlabel="angle in the bush from the joint's x axis [degrees]",
        ylabel="depth [µm]",
        xlim=(-180, 180),
        xticks=range(-180, 181, 60),
    )
    left.set_ylim(bottom=0)
    left.legend(fontsize=8, frameon=False)
    for run, color, name in (
        (first, "black", "first cycle"),
        (worn.run, LINES[2], "after 4000"),
    ):
        e = 1e6 * np.asarray(run.eccentricity("pin"))[1:]
        right.plot(e[:, 0], e[:, 2], color=color, label=name)
    turn = np.linspace(0, 2 * np.pi, 200)
    right.plot(
        1e6 * clearance * np.cos(turn),
        1e6 * clearance * np.sin(turn),
        color="0.7",
        linewidth=0.8,
        label="clearance",
    )
    right.set(xlabel="x of the pin in its bush [µm]", ylabel="z [µm]", aspect="equal")
    right.legend(
        fontsize=8, frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1)
    )
    return figure


def worn_along() -> Figure:
    """Bearing of the page's shaft that tilts: its depth along the axis with the cycles, and around it in the end."""
    page = (FOLDER.parent / "concepts" / "wear.md").read_text()
    code = page.split("## Wear along the axis")[1].split("```python\n")[1]
    names: dict = {"sj": sj, "np": np, "jnp": jnp}
    exec(code.split("run = ")[0], names)
    turn = names["turn"]
    worn = sj.studies.wear_in(
        names["tilted"],
        "pin",
        np.linspace(0.0, 0.1 + turn, 21),
        k_socket=1e-13,
        k_ball=0.0,
        window=(0.1, 0.1 + turn),
        cycles=1200.0,
        foundation=1e12,
        rtol=1e-8,
    ).wear
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(8.6, 3.4), layout="constrained", width_ratios=(1, 1.2)
    )
    along = 1e3 * worn.along
    for block, cycles in list(enumerate(worn.cycles))[2::2]:
        shade = plt.get_cmap("viridis_r")(cycles / worn.cycles[-1])
        deepest = 1e6 * worn.depth("socket", block).max(axis=1)
        left.plot(along, deepest, "o-", ms=4, color=shade, label=f"{cycles:.0f} cycles")
    left.set(xlabel="place along the axis [mm]", ylabel="largest depth [µm]")
    left.set_ylim(bottom=0)
    left.legend(fontsize=8, frameon=False)
    u = worn.directions[0]
    angles = np.degrees(np.arctan2(u[:, 1], u[:, 0])) % 360
    order = np.argsort(angles)
    shades = plt.get_cmap("plasma")(np.linspace(0, 0.85, len(along)))
    for place, depth, shade in zip(along, worn.depth("socket"), shades, strict=True):
        label = f"{place + 0.0:.1f} mm"
        right.plot(angles[order], 1e6 * depth[order], color=shade, label=label)
    right.set(
        xlabel="angle in the bearing from the joint's x axis [degrees]",
        ylabel="depth [µm]",
        xlim=(120, 240),
    )
    right.set_ylim(bottom=0)
    right.legend(fontsize=8, frameon=False, title="along the axis", title_fontsize=8)
    return figure


def friction_band() -> Figure:
    """The lamp of the page on bands of friction: efforts that move it, and where it stays by itself."""
    source = (FOLDER.parent / "howto" / "friction_band.md").read_text()
    names: dict = {}
    exec(source.split("```python\n")[1].split("found = ")[0], names)
    found = sj.studies.friction_band(
        names["lamp"](0.3), names["elevation"], (-1.2, 1.2), samples=121
    )
    figure, panel = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for first, last in found.bands:
        first, last = np.clip([first, last], -1.2, 1.2)
        panel.axvspan(first, last, color="0.93", linewidth=0)
    panel.axhline(0.0, color="0.6", linewidth=0.8)
    x = np.asarray(found.positions)
    panel.fill_between(
        x, found.backward, found.forward, color=LINES[1], alpha=0.15, linewidth=0
    )
    panel.plot(x, found.forward, color=LINES[1], label="moves up from here on")
    panel.plot(
        x, found.backward, color=LINES[1], linestyle="--", label="moves down below"
    )
    panel.set(xlabel="elevation [rad]", ylabel="moment on the arm [N m]")
    panel.margins(x=0)
    panel.legend(
        fontsize=8,
        frameon=False,
        ncols=2,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )
    return figure


def end_compliance() -> Figure:
    """Where 1 N in any direction of the plane x, z moves a tool on a bushing, at three distances from it."""
    law = sj.laws.MatrixElastomer(
        stiffness=np.diag([3e4, 5e4, 7e4]),
        damping=np.diag([30.0, 50.0, 70.0]),
        rotational_stiffness=np.diag([40.0, 60.0, 90.0]),
        rotational_damping=np.diag([0.04, 0.06, 0.09]),
    )
    mount = sj.Fixed(("ground", "hand"), "hand.mount", sj.Bushing(law=law))
    angles = np.linspace(0.0, 2 * np.pi, 181)
    force = np.stack([np.cos(angles), 0 * angles, np.sin(angles)])
    figure, panel = plt.subplots(figsize=(4.6, 4.8), layout="constrained")
    for arm, color in zip((0.1, 0.2, 0.3), LINES[1:], strict=False):
        points = {"tool": (arm, 0, arm / 3), "mount": (0, 0, 0)}
        hand = sj.Body(2.0, (0.02, 0.03, 0.04), points=points)
        scene = sj.Scene({"hand": hand}, {"mount": mount})
        found = sj.studies.end_compliance(scene, "hand.tool")
        x, _, z = 1e6 * np.asarray(found.compliance[:3, :3]) @ force
        panel.plot(x, z, color=color, label=f"{100 * arm:.0f} cm from the bushing")
    panel.set(aspect="equal", xlim=(-1400, 1400), xlabel="x [µm]", ylabel="z [µm]")
    panel.legend(fontsize=8, frameon=False, loc="lower left")
    return figure


PICTURES: dict[str, Callable[[], Figure | Image.Image]] = {
    "four_bar": four_bar,
    "accelerations": accelerations,
    "orbits": orbits,
    "films": films,
    "restitution": restitution,
    "conformity": conformity,
    "piston": piston,
    "tilting": tilting,
    "warm_oil": warm_oil,
    "bearing_heat": bearing_heat,
    "lined_bearing": lined_bearing,
    "lined_socket": lined_socket,
    "thickening": thickening,
    "friction": friction,
    "joint_friction": joint_friction,
    "rubber": rubber,
    "controllers": controllers,
    "modes": modes,
    "continuation": continuation,
    "swept_sine": swept_sine,
    "rig": rig,
    "rig_toe": rig_toe,
    "report": report,
    "suspension_over_bump": suspension,
    "wear": wear,
    "wear_in": wear_in,
    "gears": gears,
    "pose_play": pose_play,
    "inverse_dynamics": inverse_dynamics,
    "friction_band": friction_band,
    "worn_bush": worn_bush,
    "worn_along": worn_along,
    "end_compliance": end_compliance,
    **{f"scene_{name}": scene(name) for name in sj.gallery.__all__},
}


def save(name: str, figure: Figure | Image.Image) -> None:
    """Write a picture with few colors, which is a third of its size."""
    image = figure
    if isinstance(figure, Figure):
        buffer = BytesIO()
        figure.savefig(buffer, format="png", dpi=110, facecolor="white")
        plt.close(figure)
        image = Image.open(buffer)
    # By coverage: by frequency a short line takes the color of a longer one.
    few = image.convert("RGB").quantize(96, Image.Quantize.MAXCOVERAGE)
    few.save(FOLDER / f"{name}.png", optimize=True)


def main(names: list[str]) -> None:
    """Make the pictures named, or all."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or PICTURES:
        save(name, PICTURES[name]())
        print(f"{name}.png, {(FOLDER / f'{name}.png').stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
