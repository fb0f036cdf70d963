"""Reports: what a page says, that it says it loudly, that nothing leaves it, and the mechanism in it that plays."""

import base64
import hashlib
import html
import html.parser
import json
import re
import time
import warnings

import browsing
import cases
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax import cli
from spherejax.motion.integration.audit import CHECKS
from spherejax.output.plot.style import new_figure
from spherejax.output.report.motion import viewed
from spherejax.output.report.numbers import numbers_of
from spherejax.output.report.page import Page, PagePicture, PageTable, PageText

needs_browser = pytest.mark.skipif(bool(browsing.missing()), reason=browsing.missing() or "-")
EVIL = """<script>alert("x")</script> & 'so' </script>"""
TS = np.linspace(0.0, 0.5, 51)


class Reader(html.parser.HTMLParser):
    """What a page is made of: its text outside of scripts and styles, links, open elements."""

    def __init__(self, text):
        super().__init__()
        self.text, self.scripts, self.links, self.open, self.handlers = "", [], [], [], []
        self.headings, self.classes, self.titles = [], [], []
        self.feed(text)
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("src", "href", "data", "action", "srcset")]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.classes += [value for name, value in attrs if name == "class"]
        if tag not in ("meta", "img", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        where = self.open[-1] if self.open else ""
        if where == "script":
            self.scripts.append(data)
        elif where != "style":
            self.text += data
        if where == "h2":
            self.headings.append(data)


def pendulum(name="arm", hinge="hinge", mass=0.5):
    """A bar on a hinge."""
    bar = sj.Body(mass, (1e-2, 1e-3, 1e-2), (0.3, 0.0, 0.0), points={"top": (-0.3, 0.0, 0.0), "tip": (0.3, 0.0, 0.0)})
    return sj.Scene({name: bar}, {hinge: sj.Revolute(("ground", name), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})


@pytest.fixture(scope="module")
def run():
    return sj.simulate(pendulum(EVIL, "<i>h</i>"), jnp.asarray(TS))


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    return run.report(tmp_path_factory.mktemp("report") / "new" / "run.html", title=EVIL)


@pytest.fixture(scope="module")
def read(written):
    return Reader(written.read_text(encoding="utf-8"))


def verdict(page):
    """Text between the title and the first section."""
    return re.search(r"</h1>(.*?)<nav>", page, re.DOTALL)[1]


# What stands in it ------------------------------------------------------------------------------------------------


def test_names_are_text_and_never_markup(read, written):
    page = written.read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert "<i>h</i>" not in page
    assert EVIL in read.text
    assert not read.handlers
    data = json.loads(read.scripts[0])  # an end tag in a name did not end the data
    assert data[0]["bodies"] == [EVIL]
    assert len(read.scripts) == 2


def test_nothing_is_asked_of_anybody(read, written):
    page = written.read_text(encoding="utf-8")
    assert read.links
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in read.links)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    digest = base64.b64encode(hashlib.sha256(read.scripts[-1].encode()).digest()).decode()
    assert policy.startswith("default-src 'none'")
    assert f"'sha256-{digest}'" in policy  # else a browser would not run it
    assert not re.search(r"url\(|@import|fetch\(|XMLHttp|WebSocket|import\(", read.scripts[-1])
    assert written.stat().st_size < 5e6


def test_a_picture_says_its_width_so_that_a_phone_does_not_enlarge_a_small_one(written):
    text = written.read_text()
    widths = [float(width) for width in re.findall(r"--inches: ([0-9.]+)", text)]
    assert len(widths) == text.count("<figure><img")
    assert min(widths) < 4.0 < max(widths)
    assert "min(42rem, 6rem * var(--inches, 7))" in text


def test_a_run_tells_costs_audit_peaks_numbers_citations_versions(read, run):
    expected = [
        "The mechanism",
        "The run",
        "Histories",
        "Energy by part",
        "Peaks",
        "Numbers used",
        "What to cite",
        "Versions",
    ]
    assert [one for one in read.headings if one in expected] == expected
    assert f"{int(run.stats.n_steps):,}" in read.text
    assert "energy rises by no more than was put in" in read.text
    assert sj.cite(run).splitlines()[0] in read.text
    assert jax.__version__ in read.text
    # The peak of all at once is the peak of one.
    name = f"acceleration.{EVIL}"
    assert f"{run.peak(name).value:.6g}" in read.text
    assert "fine" in " ".join(read.classes)


def test_a_failed_run_says_so_first_and_then_what_its_start_changed(read, tmp_path):
    scene = pendulum()
    thrown = eqx.tree_at(lambda scene: scene.bodies["arm"].velocity, scene, jnp.array([0.0, 0.4, -0.3]))
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        failed = sj.simulate(thrown, jnp.asarray(TS), max_steps=3)
    top = verdict(failed.report(tmp_path / "failed.html").read_text(encoding="utf-8"))
    (said,) = [str(one.message) for one in given if one.category is sj.errors.StartWarning]
    assert "'hinge'" in said
    assert html.escape(said, quote=True) in top
    assert "starts with" not in read.text  # of a run that starts as it is described
    assert "verdict failed" in top
    assert 'role="alert"' in top
    assert "FAILED (too many steps)" in top
    assert "Raise max_steps" in top


def test_a_run_without_a_second_sample_is_reported(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.SimulationWarning)
        failed = sj.simulate(pendulum(), jnp.asarray([0.0, 5.0]), max_steps=2)
    page = failed.report(tmp_path / "start.html").read_text(encoding="utf-8")
    assert "FAILED" in verdict(page)
    assert "Histories" not in Reader(page).headings


def test_what_a_law_is_not_for_is_a_caution(run, tmp_path):
    page = Page("t", "v", cautions=["beyond <its> range"])
    top = verdict(page.html())
    assert "verdict caution" in top
    assert "beyond &lt;its&gt; range" in top
    shares = run.stats.audit.at[CHECKS.index("conformity")].set(3.0)
    pressed = eqx.tree_at(lambda one: one.stats.audit, run, shares)
    top = verdict(pressed.report(tmp_path / "pressed.html").read_text(encoding="utf-8"))
    assert "verdict caution" in top
    assert "range of their elastic law" in top


@pytest.mark.slow
def test_of_lanes_the_failed_one_is_told(tmp_path):
    def build(speed):
        scene = pendulum()
        body = scene.bodies["arm"]
        turned = sj.Body(
            body.mass, body.inertia, body.position, points=body.points,
            angular_velocity=jnp.array([0.0, 1.0, 0.0]) * speed, velocity=jnp.array([0.0, 0.0, -0.3]) * speed,
        )  # fmt: skip
        return sj.Scene({"arm": turned}, scene.joints)

    speeds = {"speed": np.array([0.0, 1.0, 2000.0])}
    runs = sj.simulate_many(build, speeds, TS, max_steps=60)
    assert [int(x) for x in runs.trajectories.ended] == [0, 0, 1]
    page = sj.report(runs, tmp_path / "lanes.html").read_text(encoding="utf-8")
    assert "FAILED: 1 of 3 runs." in verdict(page)
    assert "lane 2: stopped at t" in verdict(page)
    assert "Lane 2" in Reader(page).headings


# Numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", [pytest.param(case.build, id=case.name) for case in cases.CASES])
@pytest.mark.parametrize("placed", [False, True])
def test_every_number_stands_there_with_a_unit(scene, placed):
    scene = scene()
    what = sj.equations.compile_scene(scene).system if placed else scene
    used = numbers_of(what)
    said = " ".join(one.value for one in used)
    for leaf in jax.tree.leaves(what):
        for number in np.ravel(np.asarray(leaf, float))[:12]:
            assert f"{number:.10g}" in said
    words = [one for one in used if re.match(r"[-\[0-9]", one.value)]
    assert words
    assert not [one for one in words if not one.unit], "a number without a unit"


def test_units_are_those_of_the_number_itself():
    units = {one.name: one.unit for one in numbers_of(sj.gallery.suspension())}
    assert units["forces.shock.spring.coefficients"] == "N, N/m, N/m^2, N/m^3"
    law = sj.Hertz(stiffness=1e9, exponent=1.5)
    scene = cases.ball_in_socket(sj.Dry(clearance=1e-4, normal=law))
    used = {one.name.rpartition("model.")[2]: one for one in numbers_of(scene)}
    assert used["normal.stiffness"].unit == "N/m^1.5"
    assert used["normal.stiffness"].value == "1000000000"
    assert used["clearance"].meaning.startswith("radial clearance")


# The mechanism in space -------------------------------------------------------------------------------------------


def test_the_viewer_has_the_poses_of_the_run(run):
    data = viewed(run, "")
    poses = np.frombuffer(base64.b64decode(data["poses"]), "<f4").reshape(data["frames"], 1, 7)
    times = np.linspace(data["start"], data["end"], data["frames"])
    here = [int(np.argmin(np.abs(times - t))) for t in TS]
    np.testing.assert_allclose(times[here], TS, atol=1e-12)  # 600 intervals hold 50
    np.testing.assert_allclose(poses[here, 0, :3], run.position(EVIL), atol=1e-6)
    sides = np.sum(poses[here, 0, 3:] * np.asarray(run.quaternion(EVIL)), axis=1)
    np.testing.assert_allclose(np.abs(sides), 1.0, atol=1e-6)
    # Straight between frames: neighbours are on the same side.
    assert np.all(np.sum(poses[1:, 0, 3:] * poses[:-1, 0, 3:], axis=1) > 0)


@pytest.mark.parametrize("name", sj.gallery.__all__)
def test_every_scene_of_the_gallery_is_shown(name):
    scene = getattr(sj.gallery, name)()
    data = viewed(scene, name)
    json.dumps(data, allow_nan=False)
    n = len(scene.bodies)
    assert {shape["body"] for shape in data["shapes"]} <= set(range(-1, n))
    named = {shape["text"] for shape in data["shapes"] if shape["kind"] == "name"}
    assert named == {*scene.bodies, *scene.joints}
    # A box's outlines run counterclockwise from outside: their normals point away from its middle.
    for shape in data["shapes"]:
        if shape["kind"] == "side" and shape["body"] >= 0:
            corners = np.array(shape["corners"])
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
            assert normal @ corners.mean(axis=0) >= -1e-15


def test_shapes_are_where_the_bodies_points_are():
    data = viewed(pendulum(), "")
    (bar,) = [shape for shape in data["shapes"] if shape["kind"] == "line" and shape["body"] == 0 and "rim" in shape]
    np.testing.assert_allclose(np.sort(np.array(bar["corners"])[:, 0]), [-0.3, 0.3], atol=1e-12)


# Studies ----------------------------------------------------------------------------------------------------------


def weighed(mass):
    return pendulum(mass=mass)


def test_a_sweep_with_failed_runs(tmp_path):
    swept = sj.sweep(
        weighed,
        sj.studies.product({"mass": np.array([0.2, 0.4])}),
        TS[:11],
        record=["peak reaction.hinge"],
        max_steps=2,
        workers=1,
    )
    page = sj.report(swept, tmp_path / "sweep.html", scene=weighed(0.3)).read_text(encoding="utf-8")
    assert "FAILED: 2 of 2 runs." in verdict(page)
    assert "too_many_steps" in verdict(page)
    read = Reader(page)
    assert "mass 0.2 to 0.4" in read.text  # where they failed
    assert "bodies.arm.mass" in read.text


@pytest.mark.slow
def test_a_fit(tmp_path):
    true = sj.simulate(weighed(0.5), jnp.asarray(TS))
    noise = 1e-4 * np.random.default_rng(0).normal(size=TS.size)
    measured = sj.Measured(TS, {"position.arm.z": np.asarray(true.position("arm"))[:, 2] + noise})
    fitted = sj.fit(weighed, {"mass": 0.4}, measured, noise=1e-4)
    read = Reader(fitted.report(tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert f"{fitted.estimates['mass']:.8g}" in read.text
    assert read.text.count(str(fitted).splitlines()[0]) == 1
    assert "std. dev." not in read.text  # estimates stand in one table, not two
    assert "bodies.arm.mass" in read.text
    assert "The mechanism" in read.headings


@pytest.mark.slow
def test_a_study_of_accuracy(tmp_path):
    solvers = {name: sj.studies.SOLVERS[name] for name in ("Dopri8",)}
    study = sj.work_precision({EVIL: pendulum()}, 0.2, solvers=solvers, tolerances=(1e-5,), n_repeats=1, n_samples=21)
    page = study.report(tmp_path / "accuracy.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    read = Reader(page)
    assert study.advice[EVIL] in read.text
    assert EVIL in read.headings


# Files ------------------------------------------------------------------------------------------------------------


def test_nothing_is_overwritten_unasked(tmp_path):
    path = tmp_path / "scene.html"
    path.write_text("mine")
    with pytest.raises(sj.SceneError, match="exists; choose another name"):
        sj.report(pendulum(), path)
    assert path.read_text() == "mine"
    assert sj.report(pendulum(), path, overwrite=True) == path
    assert "Not simulated" in verdict(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("what", [3.0, None, "run"])
def test_what_cannot_be_reported(what, tmp_path):
    with pytest.raises(sj.SceneError, match="cannot be reported; give a run"):
        sj.report(what, tmp_path / "no.html")


def test_other_endings_and_traced_runs_are_refused(run, tmp_path):
    with pytest.raises(sj.SceneError, match=r"give it the ending \.html"):
        run.report(tmp_path / "run.pdf")
    with pytest.raises(sj.SceneError, match="traced run"):
        jax.make_jaxpr(lambda ended: sj.report(eqx.tree_at(lambda one: one.ended, run, ended), tmp_path / "no.html"))(0)
    assert not list(tmp_path.iterdir())


def test_pictures_become_coarser_where_a_page_would_be_too_large(monkeypatch):
    figure, axes = new_figure(1, 1, 4.0, 4.0, "noise")
    axes[0, 0].imshow(np.random.default_rng(0).uniform(size=(400, 400)))
    page = Page("t", "v")
    page.add("noise", PagePicture(figure, "noise"))
    (fine,) = map(len, page._pictures().values())
    monkeypatch.setattr("spherejax.output.report.page.MOST_OF_PICTURES", fine // 2)
    (coarse,) = map(len, page._pictures().values())
    assert coarse <= fine // 2


def test_long_names_go_on_in_the_next_line_between_their_words():
    cell = PageTable(("name", "value"), [("joints.<b>x.free_angle", "-1.5")]).html()
    assert "joints.&lt;b&gt;x.<wbr>free_<wbr>angle" in cell
    assert "-1.5<" in cell


def test_a_number_that_has_only_a_letter_says_where_it_is_from():
    spring = sj.TorsionalSpring(("ground", "arm"), (0.0, 1.0, 0.0), stiffness=2.0)
    used = {one.name: one.meaning for one in numbers_of(sj.Scene(pendulum().bodies, forces={"spring": spring}))}
    assert used["forces.spring.stiffness"] == "k, as in the formula of TorsionalSpring"
    assert used["bodies.arm.mass"] == "mass"


def test_a_long_table_says_that_it_is_cut():
    page = Page("t", "v")
    page.add("rows", PageTable(("i",), [(str(i),) for i in range(1000)]), PageText(["<"]))
    read = Reader(page.html())
    assert "The first 400 of 1,000 rows." in read.text


@pytest.mark.slow
def test_the_command_writes_a_report_of_a_failed_run_too(tmp_path, capsys):
    path = tmp_path / "run.html"
    words = ["run", "simple-pendulum", "--t1", "0.1", "--samples", "11", "--max-steps", "2", "--report", str(path)]
    assert cli.main(words) == 3
    assert f"wrote {path}" in capsys.readouterr().out
    assert "FAILED" in verdict(path.read_text(encoding="utf-8"))
    assert cli.main(words) == 2
    assert "exists" in capsys.readouterr().err


# In a browser -----------------------------------------------------------------------------------------------------

DRAWN = """
const canvas = document.querySelector('.motion canvas');
const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
let sum = 0, n = 0;
for (let i = 0; i < data.length; i += 4)
    if (data[i + 3] > 0) { n += 1; sum = (sum * 31 + data[i] + 7 * data[i + 1] + 13 * data[i + 2] + i) % 1000003; }
return [n, sum];
"""


@needs_browser
def test_the_mechanism_plays_and_turns_in_a_browser_without_a_network(written, run):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    with browsing.chromium() as driver:
        browsing.set_size(driver, 1000, 900)
        driver.get(written.as_uri())
        first = driver.execute_script(DRAWN)
        assert first[0] > 2000  # pixels: bars, names, axes
        asked = driver.execute_script("return performance.getEntriesByType('resource').map(one => one.name)")
        assert all(one.startswith("data:") for one in asked)
        button, output = (driver.find_element(By.CSS_SELECTOR, f".motion {tag}") for tag in ("button", "output"))
        start = output.text
        button.click()
        browsing.wait_until(driver, lambda _: output.text != start)
        button.click()
        stopped = output.text
        time.sleep(0.2)
        assert output.text == stopped
        played = driver.execute_script(DRAWN)
        assert played != first
        canvas = driver.find_element(By.CSS_SELECTOR, ".motion canvas")
        ActionChains(driver).drag_and_drop_by_offset(canvas, 90, 40).perform()
        assert driver.execute_script(DRAWN) != played
        # The tip of the bar is drawn where the run has it, seen along y: right is x, up is z.
        place = driver.execute_script("""
            const viewer = document.querySelector('.motion').viewer;
            viewer.asAtStart(); viewer.azimuth = -90; viewer.elevation = 0; viewer.show(1);
            const at = viewer.project(viewer.anchor(0, [0, 0, 0])), from = viewer.project([0, 0, 0]);
            return [(at[0] - from[0]) / viewer.scale, (from[1] - at[1]) / viewer.scale];
        """)
        assert place == pytest.approx(np.asarray(run.position(EVIL))[-1, [0, 2]].tolist(), abs=1e-5)
        # That this test reads the canvas again and again is no fault of the page.
        assert not [one for one in driver.get_log("browser") if "readback" not in one["message"]]


@needs_browser
def test_a_page_fits_a_phone(written):
    with browsing.chromium() as driver:
        browsing.set_size(driver, 360, 740)
        driver.get(written.as_uri())
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 360
        assert driver.execute_script(DRAWN)[0] > 500


def test_force_elements_and_joints_are_told_by_what_they_are(tmp_path):
    """A body on a spring and a hinge: the range of the spring's force, its work, and the joint by its name."""
    arm = sj.Body(1.0, (0.01, 0.01, 0.01), position=(0.3, 0, 0), points={"end": (0.1, 0, 0)})
    scene = sj.Scene(
        {"arm": arm},
        {"hinge": sj.Revolute(("ground", "arm"), (0, 0, 0), (0, 1, 0))},
        {"spring": sj.SpringDamper(("ground.hook", "arm.end"), 200.0, 5.0, 0.2)},
        ground_points={"hook": (0.4, 0.0, 0.2)},
    )
    run = sj.simulate(scene, np.linspace(0.0, 0.2, 41))
    page = run.report(tmp_path / "page.html").read_text()
    force = np.asarray(run.force("spring")["force"])
    assert "Results of force elements at the samples" in page
    assert f"<td>{force.min():.6g}</td><td>{force.max():.6g}</td>" in page.replace("<wbr>", "")
    assert "work put into the bodies" in page
    assert "Revolute" in page
    assert "PlacedPair" not in page
