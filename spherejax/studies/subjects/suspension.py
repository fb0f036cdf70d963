"""The suspension over a bump: five models of the joint between wheel and A-arm (Figs 22 to 25)."""

from collections.abc import Callable, Mapping

import diffrax
import numpy as np

from spherejax.gallery import suspension
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.curves import Curves
from spherejax.studies.cases import CLEARANCE, five_models
from spherejax.studies.subject import Comparison, Length, Subject, TableColumn, TableOf

BODY, JOINT = "wheel", "wheel_a_arm"

STIFFNESS, DAMPING = 2e7, 1e-3
"""The bushing [N/m, s]: at the 20 kN of the bump it yields by the paper's 1 mm."""

BUMP = (3.0, 4.0)
"""When the wheel is on the bump [s], to the millisecond."""

STOP = (3.44, 3.60)
"""The leaf spring is on its stop [s], and shortly before and behind."""

SETTLED = 0.5
"""From here on [s] the ball has found its place in the socket, and the wheel its own."""

AT_REST = 2.9
"""The wheel is at rest [s] before the bump."""

REST = 1e-3
"""The wheel is at rest again when its height stays within this of the first rest [m]."""


def measures(run: Trajectory, one: Curves) -> Mapping[str, float]:
    """Loads and travel; the penetration of a joint with clearance; what the joint has dissipated."""
    force = np.linalg.norm(np.asarray(run.reaction(JOINT)), axis=1)
    load = np.asarray(run.force("tyre")["load"])
    before = int(np.searchsorted(one.ts, AT_REST))
    rest = one.position[before] if before < len(one.ts) else one.position[-1]
    away = np.flatnonzero(np.abs(one.position - rest) > REST)
    bare = one.clearance is None
    after = one.ts >= SETTLED
    return {
        "peak_joint_force [N]": float(force.max()),
        "time_of_peak [s]": float(one.ts[force.argmax()]),
        "peak_tyre_load [N]": float(load.max()),
        "wheel_travel [m]": float(one.position.max() - rest),
        "at_rest_from [s]": float(one.ts[away[-1]]) if away.size else 0.0,
        "largest_eccentricity [m]": float(one.distance.max()),
        "penetration [m]": np.nan if bare else float(one.distance.max() - one.clearance),
        "contact_share [-]": np.nan if bare else float(np.mean(one.distance[after] > one.clearance)),
        "dissipated_in_joint [J]": float(run.dissipated_energy(JOINT)[-1]) if run.system.force_joints else 0.0,
    }


def _measure(name: str, factor: float = 1.0) -> Callable:
    def value(row):
        found = factor * row.measures[name]
        return None if np.isnan(found) else found

    return value


COLUMNS = (
    TableColumn("peak joint force [kN]", _measure("peak_joint_force [N]", 1e-3)),
    TableColumn("at [s]", _measure("time_of_peak [s]")),
    TableColumn("max |e| [mm]", _measure("largest_eccentricity [m]", 1e3)),
    TableColumn("penetration [mm]", _measure("penetration [m]", 1e3)),
    TableColumn("in contact [%]", _measure("contact_share [-]", 1e2)),
    TableColumn("joint dissipates [J]", _measure("dissipated_in_joint [J]"), ".3g"),
    TableColumn("peak tyre load [kN]", _measure("peak_tyre_load [N]", 1e-3)),
    TableColumn("wheel travel [mm]", _measure("wheel_travel [m]", 1e3), ".5g"),
    TableColumn("at rest from [s]", _measure("at_rest_from [s]"), ".3f"),
)


def summaries(comparison: "Comparison") -> list[TableOf]:
    """What each model costs, and how far it is from the ideal joint."""
    heads = (
        "model", "largest |dz| [mm]", "of the travel [%]", "rms z_ddot [m/s^2]", "rms of its difference [m/s^2]",
        "peak |z_ddot| [m/s^2]",
    )  # fmt: skip
    rows = [
        (row.label, *(f"{value:.3g}" for value in differences(comparison, row.name).values()))
        for row in comparison.rows
    ]
    title = f"The wheel against that of the ideal joint, from {SETTLED:g} s on"
    return [_times(comparison), TableOf(title, heads, rows)]


def differences(comparison: "Comparison", name: str) -> dict[str, float]:
    """Of one model from the ideal joint, behind the first impacts: the wheel's height [m] and acceleration [m/s^2]."""
    ideal, one = comparison.ideal, comparison.models[name]
    after = ideal.ts >= SETTLED
    height = np.max(np.abs(one.position - ideal.position)[after])
    acceleration, ideal_acceleration = one.acceleration[after], ideal.acceleration[after]
    return {
        "height [mm]": 1e3 * float(height),
        "of the travel [%]": 1e2 * float(height / np.ptp(ideal.position[after])),
        "acceleration [m/s^2]": _rms(acceleration),
        "difference [m/s^2]": _rms(acceleration - ideal_acceleration),
        "peak [m/s^2]": float(np.max(np.abs(acceleration))),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def remarks(comparison: "Comparison") -> list[str]:
    """The paper's finding on the mechanism as a whole, in numbers."""
    ideal, *others = comparison.rows
    worst = max(others, key=lambda row: differences(comparison, row.name)["of the travel [%]"])
    found = differences(comparison, worst.name)

    def spread(name: str) -> float:
        return 1e2 * max(abs(row.measures[name] / ideal.measures[name] - 1) for row in others)

    gaps = [row for row in others if row.name != "bushing"]
    stops = max((differences(comparison, row.name)["difference [m/s^2]"] for row in gaps), default=0.0)
    return [
        "No significant difference among the models except in the joint itself: the wheel's height differs by at most "
        f"{found['height [mm]']:.2g} mm, {found['of the travel [%]']:.2g} % of its travel ({worst.label}), the peak "
        f"tyre load by {spread('peak_tyre_load [N]'):.2g} %, the peak force of the joint by "
        f"{spread('peak_joint_force [N]'):.2g} %.",
        f"Accelerations differ where the leaf spring meets its stop: by {stops:.2g} m/s^2 in the mean of squares "
        f"with a clearance; a bushing vibrates there in a phase of its own "
        f"({differences(comparison, 'bushing')['difference [m/s^2]']:.2g} m/s^2).",
    ]


def _times(comparison: "Comparison") -> TableOf:
    heads = ["model", "method", "steps", "warm run [ms]", "time ratio"]
    has_fixed = comparison.rows[0].fixed is not None
    fixed = type(comparison.subject.fixed_solver).__name__
    heads += [f"{fixed}: steps", "warm run [ms]", "time ratio"] if has_fixed else []
    rows = []
    for row in comparison.rows:
        cells = [row.label, row.method.partition(":")[0]]
        for timed in (row, *((row.fixed,) if row.fixed is not None else ())):
            cells += [f"{timed.n_steps:,}", f"{1e3 * timed.seconds:.3g}", f"{timed.time_ratio:.3g}"]
        rows.append(cells)
    return TableOf("Computing time: with the automatic choice, and with one explicit method", heads, rows)


def figures(comparison: "Comparison") -> dict[str, Callable]:
    """Functions that draw the figures, by file name; of a comparison that is not done yet, those that can be drawn."""
    timed = {"fig25_time_ratio": lambda: _time_ratios(comparison)} if comparison.rows else {}
    return {
        **figures_ahead(comparison.subject),
        "fig23_models": lambda: _models(comparison),
        "fig23_differences": lambda: _differences(comparison),
        "fig24_eccentricity": lambda: _eccentricity(comparison),
        "fig24_joint": lambda: _joint(comparison),
        **timed,
    }


def figures_ahead(subject: Subject) -> dict[str, Callable]:
    """That of the figures that needs no run."""
    return {"fig22_mechanism": lambda: _mechanism(subject)}


def _mechanism(subject: Subject):
    from spherejax.output.drawing import draw

    # As rods, leaf spring and tie rod can be seen.
    scene = suspension(subject.models["dry"].model, link_mass=0.01)
    return draw(scene, view=(-35.0, 15.0), title="Right front suspension, at the start")


def _labels(comparison: "Comparison") -> dict[str, str]:
    """Names of the models, the ideal one last, so that it is drawn in front of those that coincide with it."""
    names = [name for name in comparison.models if name != "ideal"]
    return {name: comparison.models[name].label for name in (*names, "ideal")}


def _models(comparison: "Comparison"):
    from spherejax.output.plot.panels import Panel, Shade, model_histories

    models = comparison.models
    ts = comparison.ideal.ts
    after = ts >= SETTLED
    peak = max(float(np.max(np.abs(one.acceleration[after]), initial=1.0)) for one in models.values())
    loads = {name: 1e-3 * np.asarray(run.force("tyre")["load"]) for name, run in comparison.runs.items()}
    forces = {name: 1e-3 * np.linalg.norm(run.reaction(JOINT), axis=1) for name, run in comparison.runs.items()}
    accelerations = {name: one.acceleration for name, one in models.items()}
    limits, z_ddot = (-1.15 * peak, 1.15 * peak), "wheel z acceleration [m/s$^2$]"
    panels = [
        Panel("position", "wheel z [mm]", ts, {name: 1e3 * one.position for name, one in models.items()}),
        Panel("velocity", "wheel z velocity [m/s]", ts, {name: one.velocity for name, one in models.items()}),
        Panel("acceleration", z_ddot, ts, accelerations, limits=limits),
        Panel("mechanical energy", "energy change [J]", ts, {n: one.energy_change for n, one in models.items()}),
        Panel("force of the studied joint", "force [kN]", ts, forces),
        Panel("load of the tyre", "load [kN]", ts, loads),
        Panel("acceleration while the leaf spring is on its stop", z_ddot, ts, accelerations, STOP, limits),
        Panel("force of the studied joint, the same time", "force [kN]", ts, forces, STOP),
    ]
    title = f"Suspension over the bump\n{comparison.subject.parameters}"
    return model_histories(panels, _labels(comparison), title, shade=Shade(BUMP, "bump"))


def _differences(comparison: "Comparison"):
    from spherejax.output.plot.panels import Panel, Shade, model_histories

    ideal = comparison.ideal
    others = {name: one for name, one in comparison.models.items() if name != "ideal"}
    heights = {name: 1e3 * (one.position - ideal.position) for name, one in others.items()}
    accelerations = {name: one.acceleration - ideal.acceleration for name, one in others.items()}
    after = ideal.ts >= SETTLED
    peak = max(float(np.max(np.abs(values[after]), initial=1e-3)) for values in accelerations.values())
    travel, largest = 1e3 * np.ptp(ideal.position), float(np.max(np.abs(ideal.acceleration[after]), initial=0.0))
    panels = [
        Panel("position", "difference of wheel z [mm]", ideal.ts, heights, remark=f"the wheel travels {travel:.0f} mm"),
        Panel(
            "acceleration",
            "difference of wheel z acceleration [m/s$^2$]",
            ideal.ts,
            accelerations,
            limits=(-1.2 * peak, 1.2 * peak),
            remark=f"the acceleration itself reaches {largest:.0f} m/s$^2$",
        ),
    ]
    labels = {name: label for name, label in _labels(comparison).items() if name != "ideal"}
    return model_histories(panels, labels, "Difference from the ideal joint", n_columns=1, shade=Shade(BUMP, "bump"))


def _eccentricity(comparison: "Comparison"):
    from spherejax.output.plot.eccentricity import eccentricity_paths

    title = f"Ball's center in the socket, seen along the car; orange: in contact\n{comparison.subject.parameters}"
    return eccentricity_paths(comparison.models, title, every=2, plane=(1, 2), outer=True)


def _joint(comparison: "Comparison"):
    from spherejax.output.plot.panels import Panel, Shade, model_histories

    models = {name: one for name, one in comparison.models.items() if name != "ideal"}
    ts = comparison.ideal.ts
    pressed = {n: 1e6 * (one.distance - one.clearance) for n, one in models.items() if one.clearance is not None}
    first = (0.0, 0.04)
    panels = [
        Panel("penetration", "|e| - c [µm]", ts, pressed, window=(SETTLED, float(ts[-1]))),
        Panel("penetration, the beginning", "|e| - c [µm]", ts, pressed, window=first),
        Panel(
            "bushing",
            "|e| [mm]",
            ts,
            {name: 1e3 * one.distance for name, one in models.items() if one.clearance is None},
        ),
        Panel(
            "force of the joint, the beginning",
            "force [kN]",
            ts,
            {name: 1e-3 * np.linalg.norm(run.reaction(JOINT), axis=1) for name, run in comparison.runs.items()},
            window=first,
        ),
    ]
    title = f"The studied joint by itself\n{comparison.subject.parameters}"
    return model_histories(panels, _labels(comparison), title, shade=Shade(BUMP, "bump"))


def _time_ratios(comparison: "Comparison"):
    from spherejax.output.plot.ratios import Bar, time_ratios_by_method

    rows = comparison.rows
    methods = {"automatic choice": [Bar(row.time_ratio, row.n_steps, row.seconds) for row in rows]}
    fixed = [Bar(row.fixed.time_ratio, row.fixed.n_steps, row.fixed.seconds) for row in rows if row.fixed is not None]
    if fixed:
        methods[f"{type(comparison.subject.fixed_solver).__name__}, the pair of ode45"] = fixed
    title = f"Computing time of {comparison.t_end:g} s of motion (one core, warm, rtol 1e-8)"
    return time_ratios_by_method({row.name: row.label for row in rows}, methods, title)


SUSPENSION = Subject(
    name="suspension",
    build=suspension,
    body=BODY,
    joint=JOINT,
    models=five_models(stiffness=STIFFNESS, damping=DAMPING),
    axis="z",
    full=Length(seconds=6.0, interval=1e-4, fine=(0.05, 1e-5)),
    quick=Length(seconds=4.2, interval=1e-3, fine=(0.05, 1e-5), fixed=False),
    columns=COLUMNS,
    figures=figures,
    figures_ahead=figures_ahead,
    measures=measures,
    summaries=summaries,
    remarks=remarks,
    reference=CLEARANCE,
    tracks_work=True,
    fixed_solver=diffrax.Dopri5(),
)
"""The paper's second mechanism."""
