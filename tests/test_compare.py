"""Joint models compared on a mechanism of the user's own: which joint, which numbers, what is said and drawn."""

import csv
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax import cli
from spherejax.output.plot.curves import Curves, axis_of_motion
from spherejax.output.plot.eccentricity import eccentricity_paths, main_plane
from spherejax.output.plot.histories import four_histories
from spherejax.output.plot.phase import phase_portraits
from spherejax.output.plot.style import MODEL_COLORS, model_colors
from spherejax.studies.cases import five_models, limit_studies, parameter_studies
from spherejax.studies.subject import TableColumn
from spherejax.studies.subjects.own import own_mechanism

SPEED = 60.0
"""Of the crank [rad/s]."""


def slider_crank(model=None):
    """A crank that is driven, and the rod of a slider on a ball at its pin."""
    steel = {"density": 7850.0}
    crank = sj.Body.rod({"hub": (0, 0.03, 0), "pin": (0, 0.03, 0.04)}, radius=8e-3, **steel)
    rod = sj.Body.rod({"big": (0, 0.03, 0.04), "small": (0.2, 0, 0)}, radius=6e-3, **steel)
    slider = sj.Body.box((0.04, 0.03, 0.03), position=(0.2, 0, 0), **steel)
    across = np.cross((0.2, -0.03, -0.04), (0.0, 0.0, 1.0))
    second = np.cross((0.2, -0.03, -0.04), across)
    return sj.Scene(
        {"crank": crank, "rod": rod, "slider": slider},
        {
            "motor": sj.RotationDriver(("ground", "crank"), (0, 1, 0), sj.functions.Linear(SPEED)),
            "bearing": sj.Revolute(("ground", "crank"), "crank.hub", (0, 1, 0)),
            "guide": sj.Prismatic(("ground", "slider"), (0.2, 0, 0), (1, 0, 0)),
            "cross": sj.Universal(("rod", "slider"), (0.2, 0, 0), across, second),
            "pin": sj.Spherical("rod.big", "crank.pin", sj.Ideal() if model is None else model),
        },
    )


def plain():
    """The same scene without a model to be given, as a file has it."""
    return slider_crank(sj.Ideal())


def subject(scene=plain, t1=0.1, **options):
    return own_mechanism(scene, t1, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {},
            r"joints 'bearing', 'pin' can take the models: name the one that is studied, joint='bearing'.*--of bearing",
        ),
        ({"joint": "pim"}, "did you mean 'pin'"),
        ({"joint": "guide"}, "contact and film belong to spherical and revolute joints"),
        ({"joint": "motor"}, "a RotationDriver joint has no model; there are: bearing, pin"),
        ({"joint": "bearing"}, r"needs? the length of its bearing: models=sj.joint_models\(length=0.02\)"),
        ({"joint": "pin", "body": "slide"}, "did you mean 'slider'"),
        ({"joint": "pin", "models": {"dry": 1e-4}}, "'dry' is 0.0001, which is no joint model"),
        ({"joint": "pin", "models": {"dry": sj.Dry(-1e-4)}}, "clearance = -0.0001 must be positive"),
        ({"joint": "bearing", "models": {"dry": sj.Dry(1e-4)}}, "the length of its bearing"),
        ({"joint": "pin", "t1": -1.0}, "t1 = -1.0 must be a positive time"),
        ({"joint": "pin", "samples": 1}, "samples = 1 must be at least 2"),
        ({"joint": "pin", "axis": "w"}, "axis = 'w' is none of x, y, z"),
        ({"scene": 3}, "3 is no scene and no builder"),
        ({"scene": lambda: 3}, "the builder returned 3"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_anything_is_computed(options, message):
    with pytest.raises(sj.SceneError, match=message):
        subject(**options)


def test_the_studied_joint_is_named_or_the_only_one_that_it_can_be():
    assert subject(joint="pin").joint == "pin"
    assert subject(slider_crank).joint == "pin"  # the joint that the builder gives its model
    assert subject(slider_crank(sj.Dry(1e-4))).joint == "pin"  # the only one that is not ideal
    assert subject(sj.gallery.four_bar).joint == "coupler_rocker"
    assert subject(plain, joint="bearing", models=sj.joint_models(length=0.02)).joint == "bearing"


def test_the_models_share_the_numbers_of_the_joint_s_own_model():
    own = sj.Dry(2e-4, socket_radius=8e-3, friction=sj.Threlfall(mu=0.2), normal=sj.Flores(restitution=0.5))
    models = {name: case.model for name, case in subject(slider_crank(own)).models.items()}
    assert list(models) == ["ideal", "dry", "friction", "lubricated", "bushing"]
    assert {models[name].clearance for name in ("dry", "friction", "lubricated")} == {2e-4}
    assert {models[name].socket_radius for name in ("dry", "friction", "lubricated")} == {8e-3}
    assert models["dry"].friction is None
    assert models["friction"].friction.mu == 0.2
    assert models["friction"].normal.restitution == 0.5
    journal = sj.joint_models(length=0.02, stiffness=3e6)
    assert journal["dry"].conformity.length == journal["lubricated"].film.length == 0.02
    assert journal["bushing"].law.conical_stiffness == pytest.approx(3e6 * 0.02**2 / 12)
    assert sj.joint_models(sj.Bushing(5e5, 1e-3))["bushing"].law.stiffness == 5e5
    oily = sj.Lubricated(1e-4, viscosity=0.1)
    assert sj.joint_models(oily)["lubricated"].viscosity == 0.1
    assert sj.joint_models(oily, viscosity=0.2, clearance=2e-4)["lubricated"].e_h0 == 2e-6


def test_a_journal_keeps_its_film_and_has_one_length():
    own = sj.Lubricated(
        1e-4,
        viscosity=0.1,
        film=sj.laws.LongBearing(0.05),
        conformity=sj.laws.EsduCylinder(0.05),
        friction=sj.Threlfall(mu=0.2),
    )
    models = sj.joint_models(own)
    assert isinstance(models["lubricated"].film, sj.laws.LongBearing)
    assert models["lubricated"].film.length == models["dry"].conformity.length == 0.05
    longer = sj.joint_models(own, length=0.06)
    assert isinstance(longer["lubricated"].film, sj.laws.LongBearing)
    assert isinstance(longer["dry"].conformity, sj.laws.EsduCylinder)
    assert longer["lubricated"].film.length == longer["dry"].conformity.length == 0.06
    rubbing = sj.joint_models(sj.Ideal(friction=sj.Threlfall(mu=0.2), radius=0.01), length=0.02)
    assert rubbing["friction"].friction.mu == 0.2
    assert rubbing["ideal"].friction is None


def test_models_like_one_keep_what_its_oil_and_its_surfaces_are():
    """Warm oil that was compared as cold, and a worn socket as a round one, would say nothing."""
    heat = sj.laws.OilHeat(sj.laws.ReynoldsViscosity(0.03), 5.0, socket_conductance=1.0)
    thickening = sj.laws.BarusThickening(2e-8)
    kept = sj.joint_models(sj.Lubricated(1e-4, 0.1, heat=heat, thickening=thickening), viscosity=0.2)["lubricated"]
    assert eqx.tree_equal((kept.heat, kept.thickening), (heat, thickening))
    depth = sj.laws.FourierDepth([1e-5, 2e-6, 0.0])
    models = sj.joint_models(sj.Dry(1e-4, socket_depth=depth))
    assert all(eqx.tree_equal(models[name].socket_depth, depth) for name in ("dry", "friction"))
    assert models["dry"].ball_depth is None


def test_the_length_of_a_bearing_is_asked_for_on_the_command_line(tmp_path, capsys):
    path = tmp_path / "crank.toml"
    sj.save_scene(plain(), path)
    for words in ([], ["--clearance", "0.2 mm"], ["--mu", "0.1"]):
        assert cli.main(["compare", str(path), "--of", "bearing", *words, "--out", str(tmp_path / "out")]) == 2
        assert "need the length of its bearing: --length 0.02" in capsys.readouterr().err


def test_an_ideal_model_is_added_and_others_keep_their_names():
    mine = {"new": sj.Dry(1e-4), "worn": sj.Dry(3e-4)}
    found = subject(joint="pin", models=mine)
    assert {name: case.kind for name, case in found.models.items()} == {"ideal": "ideal", "new": "dry", "worn": "dry"}
    assert found.ideal == "ideal"
    assert subject(joint="pin", models={"perfect": sj.Ideal(), **mine}).ideal == "perfect"


def test_studies_and_limits_of_the_paper_follow_from_the_five_models():
    models = five_models()
    studies = {study.name: study for study in parameter_studies(models)}
    assert list(studies) == [
        "dry_clearance", "dry_normal_law", "friction_clearance", "friction_normal_law", "friction_law",
        "lubricated_clearance", "lubricated_films", "bushing_stiffness", "bushing_damping",
    ]  # fmt: skip
    gaps = [case.model.clearance for case in studies["lubricated_clearance"].cases]
    assert gaps == [5e-5, 1e-4, 2e-4]
    assert {case.model.e_h0 for case in studies["lubricated_clearance"].cases} == {1e-6}  # as in Table 3
    assert [case.label for case in studies["bushing_damping"].cases] == ["b = 1e-4 s", "b = 1e-3 s", "b = 1e-2 s"]
    assert studies["bushing_stiffness"].cases[1] == models["bushing"]  # run once
    assert models["dry"] in studies["dry_normal_law"].cases
    limits = {(limit.kind, limit.parameter): limit for limit in limit_studies(models)}
    assert limits["dry", "clearance [mm]"].values == (0.4, 0.2, 0.1, 0.05, 0.025)
    assert limits["bushing", "bushing stiffness [N/m]"].values == (1e4, 1e5, 1e6, 1e7)
    assert limits["bushing", "bushing stiffness [N/m]"].model_of(1e4).law.damping == 1e-4
    assert limits["dry", "clearance [mm]"].model_of(0.4).clearance == pytest.approx(4e-4)


def test_the_axis_is_that_of_the_motion():
    run = sj.simulate(plain(), jnp.linspace(0.0, 0.1, 101))
    assert axis_of_motion(run, "slider") == "x"
    one = sj.plot.curves_of(run, "ideal", body="slider", joint="pin")
    assert one.position_label == "slider x [mm]"
    assert np.ptp(one.position) == pytest.approx(0.08, rel=0.01)
    flywheel = sj.Scene(
        {"wheel": sj.Body(1.0, (1e-3, 1e-3, 2e-3), angular_velocity=(0, 0, 30.0))},
        {"axle": sj.Revolute(("ground", "wheel"), (0, 0, 0), (0, 0, 1))},
    )
    run = sj.simulate(flywheel, jnp.linspace(0.0, 1.0, 11))
    turning = sj.plot.curves_of(run, "ideal", body="wheel", joint="axle")
    assert turning.axis == "rotation.z"
    assert turning.position[-1] == pytest.approx(30.0)
    assert turning.position_label == "wheel angle about z [deg]"
    assert turning.distance.max() == 0.0


def test_what_was_put_in_is_not_lost():
    """A motor accelerates and brakes the slider; an ideal mechanism loses nothing of what it puts in."""
    run = sj.simulate(plain(), jnp.linspace(0.0, 0.03, 31))
    one = sj.plot.curves_of(run, "ideal", body="slider", joint="pin")
    assert abs(one.energy_change[-1]) > 0.1
    assert abs(one.lost_energy) < 1e-8


TS = np.linspace(0.0, 1.0, 20001)


def curves(label, kind="", clearance=1e-4, axis="z", turns=20.0):
    """A ball that circles at half the clearance."""
    wave = np.sin(7 * TS)
    e = 0.5e-4 * np.stack([np.cos(2 * np.pi * turns * TS), 0 * TS, np.sin(2 * np.pi * turns * TS)], axis=1)
    return Curves(label, TS, wave, wave, wave, -TS, e, None, clearance, "rod", axis, kind)


def test_a_model_has_one_color_in_all_figures():
    kinds = {"ideal": "ideal", "new": "dry", "worn": "dry", "oil": "lubricated", "mine": ""}
    colors = model_colors(kinds)
    assert colors["ideal"] == MODEL_COLORS["ideal"]
    assert (colors["new"], colors["oil"]) == (MODEL_COLORS["dry"], MODEL_COLORS["lubricated"])
    assert len(set(colors.values())) == len(kinds)
    many = model_colors({f"model {n}": "dry" for n in range(30)})
    assert len(many) == 30
    ideal = curves("ideal", "ideal", None)
    drawn = {line.get_label(): line.get_color() for line in four_histories(
        [curves("oil", "lubricated"), curves("play", "friction")], ideal, "by kind").axes[0].lines}  # fmt: skip
    assert (drawn["oil"], drawn["play"]) == (MODEL_COLORS["lubricated"], MODEL_COLORS["friction"])
    below = eccentricity_paths({"oil": curves("oil", "lubricated")}, "by kind").axes[1].lines[0]
    assert below.get_color() == MODEL_COLORS["lubricated"]
    with pytest.raises(sj.SceneError, match="'one' are along x, those of 'ideal' along z"):
        four_histories([curves("one", axis="x")], ideal, "two axes")


def test_paths_in_the_clearance_are_curves_and_not_polygons():
    """A chord spans at most a degree or so of a circle; where samples are too coarse for that there are points."""
    path = eccentricity_paths({"fine": curves("fine")}, "path").axes[0].lines[0].get_xydata()
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert np.nanmax(steps) < 0.02 * 0.1  # of the clearance, 0.1 mm
    coarse = replace(curves("coarse", turns=7000.0))  # three samples a turn
    lines = eccentricity_paths({"coarse": coarse}, "path").axes[0].lines
    assert [line.get_linestyle() for line in lines] == ["None"]
    assert lines[0].get_marker() == "."


def test_paths_are_drawn_in_the_plane_in_which_they_are():
    """That of a journal about z would be a straight line in the plane of x and z."""
    one = curves("journal")
    about_z = replace(one, eccentricity=one.eccentricity[:, [0, 2, 1]])
    axes = eccentricity_paths({"about z": about_z}, "path").axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("along x [mm]", "along y [mm]")
    assert main_plane([one]) == main_plane([replace(one, eccentricity=0 * one.eccentricity)]) == (0, 2)
    stopped = replace(about_z, eccentricity=np.where(TS[:, None] < 0.5, about_z.eccentricity, np.nan))
    assert main_plane([about_z, stopped]) == (0, 1)


def test_energies_are_told_in_a_unit_that_fits():
    large = curves("a")
    figure = four_histories([replace(large, energy_change=-40.0 * TS)], curves("ideal", "ideal", None), "loss")
    assert figure.axes[3].get_ylabel() == "energy change [J]"


def test_a_body_at_rest_is_drawn():
    still = replace(curves("still", "dry"), **dict.fromkeys(("position", "velocity", "acceleration"), 0 * TS - 9.81))
    at_rest = replace(still, label="ideal", kind="ideal")
    four_histories([still], at_rest, "nothing moves").canvas.draw()  # a warning is an error
    phase_portraits({"ideal": at_rest, "still": still}, "nothing moves").canvas.draw()


@pytest.mark.slow
def test_a_builder_is_compared():
    found = sj.compare(slider_crank, 0.05, samples=1001, models={"play": sj.Dry(1e-4), "soft": sj.Bushing(1e6, 1e-3)})
    assert [row.name for row in found.rows] == ["ideal", "play", "soft"]
    assert found.ideal.axis == "x"
    ideal, play, soft = found.rows
    assert ideal.time_ratio == 1.0
    assert play.n_onsets > 0
    assert play.eccentricity_ratio > 1.0
    assert play.peak_acceleration > 2 * ideal.peak_acceleration
    assert play.lost_energy == pytest.approx(play.measures["joint dissipates [J]"], rel=1e-3)
    assert abs(ideal.lost_energy) < 1e-8
    assert soft.measures["peak joint force [N]"] == pytest.approx(ideal.measures["peak joint force [N]"], rel=0.1)
    text = str(found)
    assert "Joint models of pin, 0.05 s of motion" in text
    assert "determined until [s]" in text
    assert set(found.figures()) == {
        "mechanism", "models", "phase_portraits", "eccentricity", "difference", "time_ratio",
    }  # fmt: skip


@pytest.mark.slow
def test_a_run_that_fails_is_a_row_with_its_reason():
    """What is said of such a row; the rows of the others stand."""
    found = sj.compare(slider_crank, 0.02, samples=201, models={"play": sj.Dry(1e-4)}, rtol=1e-8)
    assert all(not row.failure for row in found.rows)
    row = replace(found.rows[1], failure="stopped at t = 0.01 s", lost_energy=float("nan"))
    failed = replace(found, rows=[found.rows[0], row])
    assert failed.remarks == ["play: stopped at t = 0.01 s"]
    assert "  -  " in str(failed)


@pytest.mark.slow
def test_a_scene_file_is_compared_on_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sj.save_scene(plain(), "crank.toml", settings=sj.files.SimulationSettings(t1=0.02))
    assert cli.main(["compare", "crank.toml", "--out", "found"]) == 2
    assert "name the one that is studied, --of bearing" in capsys.readouterr().err
    words = ["--of", "pin", "--quick", "--samples", "401", "--clearance", "0.2 mm", "--body", "slider"]
    assert cli.main(["compare", "crank.toml", *words, "--out", "found", "--report", "page.html"]) == 0
    out = capsys.readouterr().out
    assert "c = 0.20 mm" in out
    assert "0.02 s of motion (slider, x)" in out
    rows = {row["model"]: row for row in csv.DictReader((tmp_path / "found" / "table.csv").read_text().splitlines())}
    assert list(rows) == ["ideal", "dry", "friction", "lubricated", "bushing"]
    assert float(rows["ideal"]["time_ratio [-]"]) == 1.0
    assert {path.name for path in (tmp_path / "found").iterdir()} >= {
        "models.png", "eccentricity.png", "difference.png", "time_ratio.png", "mechanism.png", "dry.nc",
    }  # fmt: skip
    assert "Joint models of pin compared" in (tmp_path / "page.html").read_text()


def test_a_bulk_of_equal_values_has_an_axis():
    """The acceleration of a body in free fall with one impact: equal limits are a warning of Matplotlib's."""
    from matplotlib.figure import Figure

    from spherejax.output.plot.style import limit_by_bulk

    axes = Figure().subplots()
    limit_by_bulk(axes, [np.where(np.arange(1000) == 3, 700.0, -9.81)])
    low, high = axes.get_ylim()
    assert low < -9.81 < high < 0


def test_what_is_rounding_is_shown_as_about_zero():
    column = TableColumn("energy lost [mJ]", lambda row: row, rounding=1e-6)
    assert [column.cell(x) for x in (-1e-8, 0.0, 1e-5, None, float("nan"))] == ["~0", "0", "1e-05", "-", "-"]


def test_an_ideal_joint_loses_about_nothing(tmp_path, capsys):
    assert cli.main(["run", "four-bar", "--joint", "ideal", "--t1", "0.05", "--out", str(tmp_path / "run.nc")]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "energy lost" in line]
    assert "~0 (rounding)" in row
