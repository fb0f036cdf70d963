"""Figures: labels with units, the data that were given, peaks that survive, no global canvas."""

import os
import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import jax
import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

import spherejax as sj
from spherejax.command_line.figures import figures_of
from spherejax.output.plot.curves import Curves, curves_of, thinned
from spherejax.output.plot.eccentricity import eccentricity_paths
from spherejax.output.plot.histories import acceleration_and_energy, four_histories, slowest_sliding
from spherejax.output.plot.laws import friction_curves, hybrid_force, impact_loops
from spherejax.output.plot.limits import LimitCurve, limits_to_ideal
from spherejax.output.plot.panels import Panel, model_histories
from spherejax.output.plot.phase import phase_portraits
from spherejax.output.plot.ratios import time_ratios
from spherejax.output.plot.style import (
    LAW_COLORS,
    MODEL_COLORS,
    Picture,
    legend_below,
    new_figure,
    number_decades,
    typeset_number,
)
from spherejax.studies.cases import five_models, limit_studies, parameter_studies
from spherejax.studies.subject import Comparison, LimitResult, ModelRow, StudyResult
from spherejax.studies.subjects.four_bar import FOUR_BAR, law_figures
from spherejax.studies.subjects.own import study_figure

TS = np.linspace(0.0, 2.0, 20001)


def curves(label="one", clearance: float | None = 1e-4, amplitude=1.0):
    wave = amplitude * np.sin(7 * TS)
    acceleration = wave.copy()
    acceleration[7777] = 900.0
    e = 1.01e-4 * np.stack([np.sin(TS), np.zeros_like(TS), np.cos(TS)], axis=1)
    e[:100] *= 0.5
    speed = 1e-3 * (1.1 + np.cos(5 * TS))
    return Curves(label, TS, 0.03 + 1e-3 * wave, wave, acceleration, -1e-3 * TS, e, speed, clearance, "rocker")


@pytest.fixture(scope="module")
def models():
    cases = five_models()
    return {name: curves(case.label, None if name in ("ideal", "bushing") else 1e-4) for name, case in cases.items()}


def drawn(figure: Figure, panel: int):
    return {line.get_label(): line for line in figure.axes[panel].lines}


def check_readable(figure: Figure):
    """Every panel has labelled axes with units and holds something; the drawing itself gives no warning."""
    assert isinstance(figure, Figure)
    assert figure.get_suptitle()
    for ax in figure.axes:
        assert ax.lines or ax.patches or ax.collections
        assert ax.get_title(loc="left") or len(figure.axes) == 1
    figure.canvas.draw()


def test_thinning_keeps_every_peak():
    values = np.zeros(200_001)
    values[[17, 123_456]] = 5.0, -7.0
    ts, kept = thinned(np.arange(200_001.0), values)
    assert len(kept) < 3200
    assert kept.max() == 5.0
    assert kept.min() == -7.0
    assert np.all(np.diff(ts) > 0) and ts[-1] == 200_000  # noqa: PT018


def test_four_histories_show_the_curves_against_the_ideal(models):
    figure = four_histories([curves("c = 0.05 mm")], models["ideal"], "clearance", horizon=0.5)
    check_readable(figure)
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "rocker z [mm]", "rocker z velocity [m/s]", "rocker z acceleration [m/s$^2$]", "energy change [mJ]",
    ]  # fmt: skip
    assert all(ax.get_xlabel() == "time [s]" for ax in figure.axes)
    energy = drawn(figure, 3)["c = 0.05 mm"]
    assert energy.get_ydata()[-1] == pytest.approx(-2.0)  # mJ
    assert "ideal" in drawn(figure, 0)
    assert "chaotic" in figure.axes[3].texts[0].get_text()


def test_a_spike_does_not_flatten_the_acceleration(models):
    figure = acceleration_and_energy([curves()], models["ideal"], "law")
    ax = figure.axes[0]
    assert ax.get_ylim()[1] < 3.0
    assert "axis clipped; peaks from -1 to 900" in ax.texts[0].get_text()
    assert len(figure.axes) == 2


def test_the_close_up_is_where_sliding_is_slowest(models):
    one = curves("Threlfall")
    window = slowest_sliding(one, after=0.3, half_width=0.02)
    assert window is not None
    middle = sum(window) / 2
    assert np.cos(5 * middle) == pytest.approx(-1.0, abs=1e-4)
    figure = acceleration_and_energy([one], models["ideal"], "friction", close_up=window)
    assert figure.axes[2].get_xlim() == pytest.approx(window)
    assert slowest_sliding(one, after=1.99, half_width=0.02) is None


def test_phase_portraits_have_a_row_for_each_model(models):
    figure = phase_portraits(models, "portraits")
    check_readable(figure)
    assert len(figure.axes) == 10
    assert figure.axes[0].get_xlim() == figure.axes[8].get_xlim()
    assert len(figure.axes[2].lines) == 2  # the ideal motion behind, the model's in front
    assert len(figure.axes[0].lines) == 1


def test_contact_is_drawn_on_the_clearance_circle(models):
    figure = eccentricity_paths(models, "path")
    check_readable(figure)
    dry, bushing = figure.axes[0], figure.axes[3]
    assert dry.patches[0].get_radius() == pytest.approx(0.1)
    contact = dry.collections[0].get_offsets()
    np.testing.assert_allclose(np.linalg.norm(contact, axis=1), 0.101, rtol=1e-12)
    assert "in contact" in dry.get_title(loc="left")
    assert "[µm]" in bushing.get_xlabel()
    assert bushing.patches[0].get_radius() == pytest.approx(101.0)


@pytest.mark.parametrize("clearance", [1e-4, None])
def test_a_run_that_stopped_is_drawn_as_far_as_it_went(clearance, models):
    one = curves(clearance=clearance)
    e = one.eccentricity.copy()
    e[15_000:] = np.nan
    one = replace(one, eccentricity=e, position=np.where(TS < 1.5, one.position, np.nan))
    for outer in (False, True):
        figure = eccentricity_paths({"stopped": one}, "path", outer=outer)
        check_readable(figure)
        assert (f"(dashed): {'0.101 mm' if clearance else '101 µm'}" in figure.axes[0].get_title(loc="left")) == outer
        assert np.nanmax(figure.axes[1].lines[0].get_xdata()) == 2.0
    check_readable(four_histories([one], models["ideal"], "stopped"))
    check_readable(phase_portraits({"stopped": one}, "stopped"))


def test_distance_is_true_where_the_path_leaves_the_plane():
    e = 1e-4 * np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 0.5]])
    two = np.zeros(2)
    one = Curves("dry", np.array([0.0, 1.0]), two, two, two, two, e, None, 1e-4)
    path = eccentricity_paths({"dry": one}, "path", every=1, plane=(0, 2)).axes[0].lines[0].get_xydata()
    np.testing.assert_allclose(path, [[0.1, 0.0], [0.0, 0.05]], atol=1e-15)


def test_impact_loops_close_and_reach_the_maximum():
    laws = [sj.Hertz(), sj.Gonthier(restitution=0.9), sj.ExactRestitution(restitution=0.9)]
    figure = impact_loops({0.9: laws}, stiffness=1.5e11, mass=0.03, rate=0.1)
    check_readable(figure)
    lines = figure.axes[0].lines
    hertz = (1.25 * 0.03 * 0.1**2 / 1.5e11) ** 0.4
    assert lines[0].get_xdata().max() == pytest.approx(1e6 * hertz, rel=1e-6)
    for line in lines:
        assert line.get_xdata()[-1] == 0.0
        assert line.get_ydata().min() >= 0.0
    assert lines[2].get_label() == "exact (realizes 0.900)"


def test_friction_curves_are_odd_with_coulomb_as_reference():
    figure = friction_curves([sj.Coulomb(), sj.Threlfall(mu=0.2, v1=1e-3), sj.BrownMcPhee()])
    check_readable(figure)
    lines = drawn(figure, 0)
    assert set(lines) == {"Coulomb (reference)", "Threlfall", "Brown-McPhee"}
    x, y = lines["Threlfall"].get_data()
    np.testing.assert_allclose(y, 0.2 * np.tanh(x), atol=1e-12)
    assert figure.axes[1].get_xlim()[1] == pytest.approx(0.4)


def test_the_blend_is_film_before_contact_and_contact_beyond_the_transition():
    figure = hybrid_force(sj.Lubricated(1e-4, viscosity=0.4))
    check_readable(figure)
    blend, film, contact = figure.axes[1].lines[:3]
    x = blend.get_xdata()
    before, beyond = x < 0.1 - 1e-9, x > 0.101 + 1e-9
    np.testing.assert_allclose(blend.get_ydata()[before], film.get_ydata()[before])
    np.testing.assert_allclose(blend.get_ydata()[beyond], contact.get_ydata()[beyond])


def test_time_ratios_are_annotated():
    figure = time_ratios({"ideal": "ideal", "friction": "dry with friction"}, [1.0, 12.3], [207, 33_000], "time")
    check_readable(figure)
    assert figure.axes[0].get_yscale() == "log"
    assert [bar.get_height() for bar in figure.axes[0].patches] == [1.0, 12.3]
    assert figure.axes[0].get_xticklabels()[1].get_text() == "dry with friction"
    assert "33,000 steps" in figure.axes[0].texts[1].get_text()


def test_a_limit_that_ends_early_says_why():
    radial = five_models(film=sj.laws.RadialFilm())
    shortened = [s for s in limit_studies(radial) if s.parameter == "clearance [mm]" and len(s.values) < 5]
    assert [("its curve ends where" in s.label) for s in shortened] == [True]
    assert not any("ends" in s.label for s in limit_studies(five_models()))


def test_loops_that_lie_on_each_other_have_a_close_up():
    """Of narrow loops the damping is shown alone; of wide ones nothing."""
    laws = {c_r: [sj.Hertz(), sj.HuntCrossley(c_r), sj.LankaraniNikravesh(c_r)] for c_r in (0.9, 0.3)}
    narrow, wide = impact_loops(laws, stiffness=1.5e11).axes[:2]
    (inset,) = narrow.child_axes
    assert not wide.child_axes
    _, first, second = (np.abs(line.get_ydata()).max() for line in inset.lines)
    assert 1.02 * second < first < 0.15 * narrow.dataLim.ymax


def test_limits_share_a_panel_where_they_share_a_parameter():
    found = [
        LimitCurve("dry", "clearance [mm]", [0.2, 0.1], [2e-4, 1e-4], 1),
        LimitCurve("lubricated", "clearance [mm]", [0.2, 0.1], [2e-4, 1e-5]),
        LimitCurve("bushing", "stiffness [N/m]", [1e5, 1e6], [1e-4, 1e-5], -1),
    ]
    figure = limits_to_ideal(found, "limits")
    check_readable(figure)
    assert len(figure.axes) == 2
    np.testing.assert_allclose(drawn(figure, 0)["dry"].get_ydata(), [0.2, 0.1])
    assert figure.axes[1].get_xlabel() == "stiffness [N/m]"


def test_a_comparison_draws_every_figure_of_the_paper(models):
    rows = [ModelRow(n, one.label, 1e-3, 9.0, 1.0, 1, 100, 0.1, 10.0, 0.5, "Dopri8") for n, one in models.items()]
    studies = [StudyResult(s, [curves(c.label) for c in s.cases]) for s in parameter_studies(five_models())]
    limits = [
        LimitResult(s.label, s.parameter, list(s.values), [1e-4] * len(s.values), s.order)
        for s in limit_studies(five_models())
    ]
    found = figures_of(Comparison(2.0, rows, models, {}, studies, limits, 0.5, subject=FOUR_BAR))
    numbers = {name[:5] for name in found if name.startswith("fig")}
    assert numbers == {f"fig{n:02d}" for n in range(6, 22)}
    laws = {FOUR_BAR.numbered(name) for name in law_figures()}
    assert laws <= set(found)
    for name in set(found) - laws - {"fig09_mechanism"}:  # a drawing, no panels with axes
        check_readable(found[name]())


def test_a_film_has_one_color_in_all_figures(models):
    """The full film is that of the lubricated joint, the paper's is no other model's."""
    both = next(study for study in parameter_studies(five_models()) if study.name == "lubricated_films")
    result = StudyResult(both, [curves(case.label) for case in both.cases])
    found = drawn(study_figure(result, Comparison(2.0, [], models, {}, [], [], 0.5, subject=FOUR_BAR)), 0)
    assert found["full film"].get_color() == MODEL_COLORS["lubricated"]
    assert found["radial film, the paper's"].get_color() not in MODEL_COLORS.values()


def test_axes_name_the_body_that_moves(models):
    wheel = replace(models["ideal"], body="wheel")
    found = four_histories([curves()], wheel, "a car"), phase_portraits({"ideal": wheel}, "a car")
    close_up = acceleration_and_energy([curves()], wheel, "a car", close_up=(0.5, 0.6))
    assert found[0].axes[0].get_ylabel() == "wheel z [mm]"
    assert found[1].axes[0].get_xlabel() == "wheel z [mm]"
    assert close_up.axes[2].get_ylabel() == "wheel z acceleration [m/s$^2$]"


def test_more_curves_than_colors_are_all_drawn(models, monkeypatch):
    several = [curves(f"run {n}") for n in range(len(LAW_COLORS) + 2)]
    lines = drawn(four_histories(several, models["ideal"], "many"), 0)
    assert {one.label for one in several} <= set(lines)
    assert lines["run 0"].get_color() == lines[f"run {len(LAW_COLORS)}"].get_color()
    assert len(lines["run 7"].get_xdata()) > 100
    close_up = acceleration_and_energy(several, models["ideal"], "many", close_up=(0.5, 0.6))
    assert len(close_up.axes[2].lines) == len(several) + 1
    monkeypatch.setattr("spherejax.output.plot.laws._free_impact", lambda *given: (TS, TS))  # compiles for each law
    laws = [sj.HuntCrossley(restitution=c_r) for c_r in np.linspace(0.3, 0.9, len(LAW_COLORS) + 1)]
    assert len(impact_loops({0.5: laws}, stiffness=1e11).axes[0].lines) == len(laws)
    rubbing = [sj.Threlfall(mu=mu, v1=1e-3) for mu in np.linspace(0.1, 0.4, len(LAW_COLORS) + 1)]
    assert len(friction_curves(rubbing).axes[0].lines) == len(rubbing)
    wide = Panel("heights", "z [mm]", TS, {str(n): TS for n in range(7)})
    figure = model_histories([wide], {str(n): str(n) for n in range(7)}, "seven models")
    widths = [line.get_linewidth() for line in figure.axes[0].lines]
    assert len(widths) == 7
    assert np.all(np.diff(widths) < 0)


def test_curves_are_those_of_one_body_and_one_joint():
    run = sj.simulate(sj.gallery.four_bar(), np.linspace(0.0, 0.01, 5))  # as in test_cli: compiled once
    body, joint = "coupler", "coupler_rocker"
    one = curves_of(run, "ideal", body=body, joint=joint, axis="z")
    assert (one.label, one.body, one.clearance, one.sliding_speed) == ("ideal", body, None, None)
    np.testing.assert_array_equal(one.position, run.position(body)[:, 2])
    assert one.energy_change[0] == 0.0
    assert one.kind == "ideal"
    assert curves_of(run, "ideal", body=body, joint=joint).axis == "xyz"[np.ptp(run.position(body), axis=0).argmax()]
    with pytest.raises(sj.SceneError, match="axis = 'w' is none of x, y, z"):
        curves_of(run, "ideal", body=body, joint=joint, axis="w")
    lanes = jax.tree.map(lambda x: jnp.stack([x, x]), run)
    with pytest.raises(sj.SceneError, match="single run; take one lane"):
        curves_of(lanes, "two", body=body, joint=joint)
    with pytest.raises(sj.SceneError, match="no joint 'knee'"):
        curves_of(run, "one", body=body, joint="knee")
    with pytest.raises(sj.SceneError, match="no body 'leg'"):
        curves_of(run, "one", body="leg", joint=joint)


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: eccentricity_paths({"ideal": curves(clearance=None)}, "t"), "ideal joint has no eccentricity"),
        (lambda: model_histories([Panel("z", "m", TS, {"wet": TS})], {"dry": "dry"}, "t"), r"\['wet'\].*for 'dry'"),
        (lambda: model_histories([], {"dry": "dry"}, "t"), "0 rows"),
        (lambda: impact_loops({}, stiffness=1e11), "no law to draw"),
        (lambda: impact_loops({0.9: [sj.Hertz()]}, stiffness=0.0), "stiffness = 0.0 must be positive"),
        (lambda: hybrid_force(sj.Dry(1e-4)), "Dry has no film"),
        (lambda: new_figure(1, 0, 3.0, 3.0, "t"), "1 rows and 0 columns"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_said(draw, message):
    with pytest.raises(sj.SceneError, match=message):
        draw()


def test_no_figure_needs_pyplot():
    """In a process of its own: other tests load libraries that do."""
    code = (
        "import sys, spherejax as sj; sj.draw(sj.gallery.four_bar()).savefig(sys.argv[1], format='png');"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, os.devnull], check=True)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (0.1, "0.1"), (2000.0, "2000"), (1e4, "$10^{4}$"), (-2.5e-5, r"-$2.5 \times 10^{-5}$")],
)
def test_numbers_on_axes_are_typeset(value, shown):
    assert typeset_number(value) == shown


@pytest.mark.parametrize(
    ("reach", "shown"),
    [
        ((0.8, 2.1), {"1", "2"}),
        ((15.0, 400.0), {"20", "50", "100", "200"}),
        ((0.1, 1000.0), {"0.1", "1", "10", "1000"}),
    ],
)
def test_decades_are_numbered_within_one_too(reach, shown):
    figure, axes = new_figure(1, 1, 4.0, 3.0, "")
    ax = axes[0, 0]
    ax.semilogy(range(2), reach)
    number_decades(ax.yaxis, np.array(reach))
    figure.draw_without_rendering()
    low, high = ax.get_ylim()  # older versions of Matplotlib have ticks beyond it, which nobody sees
    labels = [*ax.get_yticklabels(), *ax.get_yticklabels(minor=True)]
    said = [label.get_text() for label in labels if low <= label.get_position()[1] <= high]
    assert shown <= set(said)
    assert not [text for text in said if r"\times" in text or "10^{0}" in text]


def test_titles_and_legends_are_no_wider_than_their_figure():
    figure, axes = new_figure(1, 1, 4.7, 3.0, "What the models change\n" + "a value of a parameter, " * 5)
    for name in ("ideal", "dry", "dry with friction", "lubricated", "bushing"):
        axes[0, 0].plot([0, 1], [0, 1], label=name)
    legend_below(figure, axes[0, 0])
    figure.canvas.draw()
    boxes = [figure._suptitle.get_window_extent(), figure.legends[0].get_window_extent()]  # type: ignore[union-attr]
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)
    assert figure.get_suptitle().startswith("What the models change\na value")


def test_a_picture_typesets_its_texts():
    figure, axes = new_figure(1, 1, 5.0, 2.0, "k = 1e+06 N/m, b = 2.5e-02 s, Rodas5P, v1e6")
    axes[0, 0].plot([0, 1], [0, 1], label="k = 1e5")
    axes[0, 0].legend()
    figure.savefig(BytesIO(), format="png")
    assert figure.get_suptitle() == r"k = $10^{6}$ N/m, b = $2.5 \times 10^{-2}$ s, Rodas5P, v1e6"
    assert axes[0, 0].get_legend().get_texts()[0].get_text() == "k = $10^{5}$"


def pixels(save, figure, **options):
    data = BytesIO()
    save(figure, data, format="png", **options)
    return matplotlib.image.imread(BytesIO(data.getvalue()))


@pytest.mark.parametrize(
    "draw",
    [
        lambda models: four_histories([models["friction"]], models["ideal"], "k = 1e+06 N/m", horizon=0.5),
        lambda models: phase_portraits(models, "phase"),
        lambda _: impact_loops({0.9: [sj.Hertz(), sj.Gonthier(0.9)]}, stiffness=1.5e11, mass=0.03, rate=0.1),
    ],
    ids=["histories", "portraits", "loops"],
)
def test_a_picture_is_laid_out_once_and_looks_as_it_did(draw, models, monkeypatch):
    expected = pixels(Figure.savefig, draw(models))
    figure = draw(models)
    engine = figure.get_layout_engine()
    counted = []
    monkeypatch.setattr(Figure, "draw", lambda *given, original=Figure.draw: counted.append(1) or original(*given))
    np.testing.assert_array_equal(pixels(Picture.savefig, figure), expected)
    assert len(counted) == 1
    assert figure.get_layout_engine() is engine
    assert pixels(Picture.savefig, figure, dpi=50).shape[0] < expected.shape[0]
    figure.savefig(data := BytesIO(), format="pdf")
    assert data.getvalue().startswith(b"%PDF")
