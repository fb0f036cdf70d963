"""The calls that must hold: names and arguments may be added, not lost."""

import inspect

import jax
import jax.numpy as jnp
import pytest
from public import every_name

import spherejax as sj

ARGUMENTS = {
    sj.Ideal: ("friction", "radius", "pressure", "preload", "preload_force", "length", "passes"),
    sj.laws.CosinePressure: (),
    sj.laws.UniformPressure: (),
    sj.laws.PointContact: (),
    sj.laws.PreloadAlone: (),
    sj.Dry: ("clearance", "socket_radius", "ball_radius", "normal", "friction"),
    sj.Lubricated: (
        "clearance",
        "viscosity",
        "socket_radius",
        "normal",
        "friction",
        "e_h0",
        "e_h1",
        "boundary",
        "film",
    ),
    sj.Bushing: ("stiffness", "damping", "law", "branches", "friction"),
    sj.Hertz: ("stiffness", "exponent"),
    sj.HuntCrossley: ("restitution", "stiffness", "exponent"),
    sj.LankaraniNikravesh: ("restitution", "stiffness", "exponent"),
    sj.Gonthier: ("restitution", "stiffness", "exponent"),
    sj.Flores: ("restitution", "stiffness", "exponent"),
    sj.ExactRestitution: ("restitution", "stiffness", "exponent"),
    sj.Coulomb: ("mu",),
    sj.Threlfall: ("mu", "v1"),
    sj.BengisuAkay: ("mu_kinetic", "mu_static", "v0", "kappa"),
    sj.Ambrosio: ("mu", "v0", "v1"),
    sj.BrownMcPhee: ("mu_kinetic", "mu_static", "stribeck_velocity"),
    sj.LuGre: ("mu_kinetic", "mu_static", "stribeck_velocity"),
    sj.laws.RadialFilm: (),
    sj.laws.FullFilm: (),
    sj.Guembel: (),
    sj.PinkusSternlicht: (),
    sj.Sommerfeld: (),
    sj.laws.RadialElastomer: ("stiffness", "damping"),
    sj.laws.VectorElastomer: ("stiffness", "damping"),
    sj.laws.MatrixElastomer: ("stiffness", "damping", "rotational_stiffness", "rotational_damping"),
    sj.laws.CurveElastomer: ("deflections", "forces", "damping"),
    sj.laws.Maxwell: ("stiffness", "time", "rotational_stiffness"),
    sj.laws.Berg: ("limit", "half_length", "rotational_limit", "half_angle"),
    sj.Material: ("youngs_modulus", "poissons_ratio"),
    sj.Body: ("mass", "inertia", "position", "quaternion", "velocity", "angular_velocity", "points"),
    sj.Revolute: ("bodies", "point", "axis", "model"),
    sj.joints.Rim: ("bodies", "point", "axis", "model"),
    sj.joints.tilting_journal: ("name", "bodies", "point", "axis", "model", "length"),
    sj.Universal: ("bodies", "point", "first_axis", "second_axis", "model"),
    sj.Cylindrical: ("bodies", "point", "axis", "model"),
    sj.Prismatic: ("bodies", "point", "axis", "model"),
    sj.Fixed: ("bodies", "point", "model"),
    sj.joints.PointOnPlane: ("point", "through", "normal", "body"),
    sj.joints.SameOrientation: ("bodies", "point"),
    sj.joints.ParallelAxes: ("bodies", "point", "axis"),
    sj.joints.PerpendicularAxes: ("bodies", "point", "first_axis", "second_axis"),
    sj.joints.PointOnCurve: ("point", "curve", "body"),
    sj.joints.Circle: ("center", "axis", "radius"),
    sj.joints.Line: ("through", "direction"),
    sj.joints.ImplicitCurve: ("function",),
    sj.joints.Distance: ("first", "second", "length"),
    sj.RotationDriver: ("bodies", "axis", "angle"),
    sj.TranslationDriver: ("bodies", "point", "axis", "travel"),
    sj.joints.DistanceDriver: ("first", "second", "length"),
    sj.joints.PositionDriver: ("point", "position", "body"),
    sj.laws.HingeElastomer: ("stiffness", "damping", "conical_stiffness", "conical_damping", "torsional_damping"),
    sj.laws.CrossElastomer: ("stiffness", "damping", "torsional_stiffness", "torsional_damping"),
    sj.constraint_report: ("scene", "t"),
    sj.ode: ("scene", "t0"),
    sj.joints.differentiated_rows: ("residual", "t", "body_i", "body_j", "is_driven"),
    sj.Spherical: ("socket", "ball", "model"),
    sj.Scene: ("bodies", "joints", "forces", "gravity", "ground_points", "drift"),
    sj.solvers.Baumgarte: ("alpha", "beta"),
    sj.solvers.NoDriftControl: (),
    sj.solvers.PostStabilization: (),
    sj.solvers.Projection: (),
    sj.AppliedWrench: ("body", "force", "moment", "place", "in_body_axes"),
    sj.SpringDamper: ("ends", "stiffness", "damping", "free_length", "spring", "damper", "law", "direction"),
    sj.forces.ShockAbsorber: ("ends", "compression", "extension", "spring", "free_length", "transition", "direction"),
    sj.forces.BumpStop: (
        "ends",
        "shortest",
        "longest",
        "stiffness",
        "damping",
        "onset",
        "spring",
        "damper",
        "direction",
    ),
    sj.TorsionalSpring: ("bodies", "axis", "stiffness", "damping", "free_angle", "spring", "damper"),
    sj.forces.TorsionalStop: (
        "bodies",
        "axis",
        "smallest",
        "largest",
        "stiffness",
        "damping",
        "onset",
        "spring",
        "damper",
    ),
    sj.forces.Coupler: ("first", "second", "ratio", "stiffness", "damping", "offset"),
    sj.forces.Gear: ("first", "second", "ratio", "backlash", "stiffness", "damping", "onset", "offset"),
    sj.inverse_dynamics: ("scene", "motion", "motors", "friction"),
    sj.Turn: ("bodies", "axis", "radius"),
    sj.Travel: ("ends", "direction"),
    sj.Body.from_mesh: ("mesh", "unit", "mass", "density", "position", "quaternion", "points"),
    sj.forces.Tyre: ("center", "radius", "stiffness", "damping", "onset", "road", "speed", "normal_to_road"),
    sj.functions.Constant: ("value",),
    sj.functions.Linear: ("slope", "offset"),
    sj.functions.Polynomial: ("coefficients", "center"),
    sj.functions.Sine: ("amplitude", "frequency", "phase", "offset"),
    sj.functions.Step: ("at", "before", "after"),
    sj.functions.SmoothStep: ("start", "end", "before", "after"),
    sj.functions.Bump: ("height", "start", "length"),
    sj.functions.Piecewise: ("breaks", "pieces"),
    sj.functions.Table: ("x", "y"),
    sj.functions.SmoothTable: ("x", "y"),
    sj.gallery.four_bar: ("model", "drift"),
    sj.simulate: ("scene", "ts", "rtol", "atol", "solver", "stepsize_controller", "adjoint", "throw"),
    sj.equations.compile_scene: ("scene",),
    sj.draw: ("what", "t", "scene", "view", "projections", "magnified", "plane", "traces", "frames", "labels", "title"),
    sj.view: ("run", "view", "magnified"),
    sj.animate: ("run", "path", "fps", "slow", "view", "magnified", "overwrite", "report"),
    sj.work_precision: ("scene", "t1", "solvers", "tolerances", "n_repeats"),
    sj.wear: ("run", "joint", "k_socket", "k_ball", "cycles", "window", "foundation", "cells", "largest_block"),
    sj.compiler.scalarize: ("function",),
    sj.load_scene: ("path", "allow_code"),
    sj.files.read_scene_file: ("path", "allow_code"),
    sj.save_scene: ("scene", "path", "title", "studied", "settings", "overwrite"),
    sj.load_mjcf: ("path", "keyframe", "positions", "velocities", "gravity", "drift", "ignore"),
    sj.load_urdf: ("path", "base", "positions", "velocities", "gravity", "drift", "ignore"),
    sj.runtime.configure: ("cache",),
    sj.laws.generalized_stiffness: ("socket_radius", "ball_radius", "socket_material", "ball_material"),
    sj.laws.realized_restitution: ("hysteresis_factor",),
    sj.laws.exact_hysteresis_factor: ("restitution",),
    sj.laws.maximum_penetration: ("mass", "impact_rate", "hysteresis_factor", "stiffness", "exponent"),
    sj.laws.squeeze_factor: ("eccentricity_ratio",),
    sj.laws.squeeze_coefficient: ("viscosity", "socket_radius", "clearance"),
    sj.laws.hybrid_weight: ("eccentricity", "clearance", "transition_width"),
    sj.laws.film_force: ("e", "e_rate", "clearance", "socket_radius", "viscosity", "boundary", "transition_offset"),
    sj.plot.curves_of: ("run", "label", "body", "joint"),
    sj.plot.four_histories: ("curves", "ideal", "title", "colors", "horizon"),
    sj.plot.phase_portraits: ("models", "title", "every"),
    sj.plot.eccentricity_paths: ("models", "title", "every", "plane", "outer"),
    sj.plot.model_histories: ("panels", "labels", "title", "n_columns", "shade"),
    sj.plot.Panel: ("title", "label", "ts", "curves", "window", "limits", "remark"),
    sj.plot.Shade: ("interval", "what"),
    sj.plot.impact_loops: ("families", "mass", "rate", "stiffness"),
    sj.plot.friction_curves: ("laws", "title", "fastest", "close_up"),
    sj.plot.hybrid_force: ("joint", "rate"),
    sj.plot.figures_of_sweep: ("swept", "title"),
    sj.plot.new_figure: ("n_rows", "n_columns", "width", "height", "title"),
    sj.plot.ordered_colors: ("n",),
    sj.priors.Normal: ("mean", "deviation"),
    sj.priors.LogNormal: ("median", "factor"),
}


@pytest.mark.parametrize("call", ARGUMENTS, ids=lambda call: call.__name__)
def test_arguments_exist(call):
    assert set(ARGUMENTS[call]) <= set(inspect.signature(call).parameters)


def test_simulate_takes_scene_and_times_by_position_and_the_rest_by_name():
    kinds = {name: p.kind for name, p in inspect.signature(sj.simulate).parameters.items()}
    positional = [name for name, kind in kinds.items() if kind is not inspect.Parameter.KEYWORD_ONLY]
    assert positional == ["scene", "ts"]


@pytest.mark.parametrize(
    "name",
    [
        "ts", "position", "velocity", "acceleration", "angular_velocity", "quaternion", "eccentricity",
        "eccentricity_ratio",
        "penetration", "reaction", "mechanical_energy", "kinetic_energy", "potential_energy", "elastic_energy",
        "dissipated_energy", "constraint_violation", "stats", "succeeded", "status", "diagnosis", "mode", "to_xarray",
        "driving_effort", "driving_power", "constraints", "at",
    ],
)  # fmt: skip
def test_trajectory_offers(name):
    assert hasattr(sj.Trajectory, name) or name in sj.Trajectory.__annotations__


@pytest.mark.parametrize("name", ["n_steps", "n_rejected", "n_evaluations", "n_onsets"])
def test_statistics_offer(name):
    from spherejax.motion.results.trajectory import Statistics

    assert name in Statistics.__dataclass_fields__


def test_statistics_read_in_numbers_where_they_are_known():
    run = sj.simulate(sj.gallery.simple_pendulum(), jnp.linspace(0.0, 0.1, 3))
    assert f"n_steps={int(run.stats.n_steps)}, " in repr(run.stats)
    assert "Dopri8" in repr(run.stats)
    said = []
    jax.jit(lambda stats: said.append(repr(stats)))(run.stats)
    assert "n_steps=" in said[0]


@pytest.mark.parametrize(
    "name", ["effects", "Rodas5P", "Wrench", "AbstractForce", "AbstractNormalLaw", "AbstractStaticFriction"]
)
def test_package_offers(name):
    assert name in every_name()


def test_every_public_name_has_a_docstring():
    public = every_name().values()
    silent = [thing for thing in public if (inspect.isclass(thing) or inspect.isfunction(thing)) and not thing.__doc__]
    assert not silent


def test_status_and_statistics_read_in_words():
    run = sj.simulate(sj.gallery.four_bar(sj.Ideal()), [0.0, 0.01])
    assert run.status is sj.Status.SUCCEEDED
    assert f"{run.status}" == str(run.status) == repr(run.status) == "Status.SUCCEEDED"
    assert f"{run.status:d}" == "0"
    assert int(run.status) == run.status == 0
    assert "n_steps=" in repr(run.stats)
    ks = jnp.array([1e5, 2e5])
    runs = jax.vmap(lambda k: sj.simulate(sj.gallery.four_bar(sj.Bushing(k, 1e-4)), [0.0, 0.001]))(ks)
    assert runs.status.shape == (2,)
    assert jax.tree.map(lambda x: x[1], runs).status is sj.Status.SUCCEEDED
    assert not jax.jit(lambda: sj.simulate(sj.gallery.four_bar(sj.Ideal()), jnp.array([0.0, 0.01])).status != 0)()
