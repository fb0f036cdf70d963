"""Drawings of mechanisms: what is drawn is where the mechanism is, everything is inside, and nothing covers a name."""

import io
import re
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import spherejax as sj
from spherejax.output.plot import turning
from spherejax.output.plot.animation import ffmpeg, frame_times, pace_in_words, usual_pace
from spherejax.output.plot.camera import best_camera, camera_from, three_projections
from spherejax.output.plot.magnified import JointMotion, plane_of
from spherejax.output.plot.reading import mechanism_of
from spherejax.output.plot.sheet import Sheet, Wishes
from spherejax.output.plot.space import poses_of
from spherejax.output.plot.strokes import convex_hull
from spherejax.output.plot.symbols import SYMBOLS
from spherejax.output.report.motion import viewed

DOWN = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def scene():
    return sj.gallery.four_bar(sj.Dry(clearance=1e-4))


@pytest.fixture(scope="module")
def run(scene):
    return sj.simulate(scene, jnp.linspace(0.0, 0.1, 11), rtol=1e-7)


def paths(figure: Figure, name: str, panel: int = 0) -> list[np.ndarray]:
    """What is drawn of one thing, on paper [m]."""
    return [patch.get_path().vertices for patch in figure.axes[panel].patches if patch.get_gid() == name]


def names(figure: Figure, kind: str) -> set[str]:
    found = {str(patch.get_gid()) for patch in figure.axes[0].patches}
    return {name.partition(":")[2] for name in found if name.startswith(kind)}


def labels(figure: Figure):
    return [text for text in figure.axes[0].texts if str(text.get_gid()).startswith("label:")]


def center(outline: np.ndarray) -> np.ndarray:
    return 0.5 * (outline.min(axis=0) + outline.max(axis=0))


def pendulum(**options):
    bob = sj.Body(1.0, (4e-3, 4e-3, 4e-3), position=(0.3, 0.0, -0.4), points={"hook": (-0.3, 0.0, 0.4)}, **options)
    return sj.Scene({"bob": bob}, {"hook": sj.Spherical("ground.hook", "bob.hook")}, ground_points={"hook": (0, 0, 0)})


@pytest.mark.parametrize("sample", [0, 4, 10])
def test_joints_and_bars_are_where_the_run_has_them(run, sample):
    figure = sj.draw(run, float(run.ts[sample]), view=(40, 15))
    camera = camera_from(40, 15, DOWN)
    state = jax.tree.map(lambda x: np.asarray(x[sample]), run.state)
    turned = mechanism_of(run).pose(float(run.ts[sample])).rotations["rocker"]
    rocker = state.position[list(run.system.bodies).index("rocker")]
    ends = camera.project(rocker + np.array([[0.0, -0.037, 0.0], [0.0, 0.037, 0.0]]) @ turned.T)
    bar = paths(figure, "body:rocker")[1]
    np.testing.assert_allclose(sorted(bar.tolist()), sorted(ends.tolist()), atol=1e-12)
    ring = paths(figure, "joint:coupler_rocker")[0]
    assert np.linalg.norm(center(ring) - ends[0]) < 1.01e-4 + 1e-6  # the socket's center: within the clearance
    pivot = paths(figure, "joint:rocker_pivot")[0]
    np.testing.assert_allclose(center(pivot), camera.project(np.array([-0.040, -0.085, 0.0])), atol=1e-6)


def test_a_scene_is_drawn_at_its_assembled_start(scene):
    figure = sj.draw(scene)
    assert figure.get_suptitle() == "assembled start"
    assert names(figure, "body:") == {"crank", "coupler", "rocker"}
    assert names(figure, "joint:") == set(scene.joints)
    assert names(figure, "ground:") == {"crank_pivot", "rocker_pivot"}


def test_a_notebook_shows_a_figure_that_pyplot_does_not_know(scene):
    """IPython asks an object for its picture where no formatter is registered for its type."""
    figure = sj.draw(scene)
    with Image.open(io.BytesIO(figure._repr_png_())) as picture:
        shown = np.asarray(picture.convert("L"))
    assert shown.shape[1] > 500
    assert shown.min() < 50  # something is drawn
    assert shown.max() > 200


def test_limits_enclose_everything_with_equal_scales(run):
    figure = sj.draw(run, 0.1, projections=True, traces=["rocker", "coupler_rocker"])
    figure.canvas.draw()
    panels = [ax for ax in figure.axes if any(patch.get_gid() == "body:crank" for patch in ax.patches)]
    assert len(panels) == 4
    for ax in panels:
        (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
        drawn = np.concatenate([patch.get_path().vertices for patch in ax.patches])
        drawn = np.concatenate([drawn, *(line.get_xydata() for line in ax.lines[:2])])
        drawn = drawn[np.isfinite(drawn).all(axis=1)]
        assert x0 < drawn[:, 0].min() and drawn[:, 0].max() < x1  # noqa: PT018
        assert y0 < drawn[:, 1].min() and drawn[:, 1].max() < y1  # noqa: PT018
        box = ax.get_window_extent()
        assert (x1 - x0) / box.width == pytest.approx((y1 - y0) / box.height, rel=1e-6)
    axial = [ax for ax in panels if ax.get_title(loc="left")]
    scales = [np.ptp(ax.get_xlim()) / ax.get_window_extent().width for ax in axial]
    assert len(scales) == 3
    np.testing.assert_allclose(scales, scales[0], rtol=1e-6)


def test_projections_show_the_coordinates_that_their_axes_name(run):
    figure = sj.draw(run, 0.1, projections=True)
    socket = np.asarray(run.position("coupler")[-1])
    mark = {ax.get_title(loc="left"): ax for ax in figure.axes}
    for title, (i, j) in {"front": (0, 2), "side": (1, 2), "top": (0, 1)}.items():
        ax = mark[title]
        circle = [p.get_path().vertices for p in ax.patches if p.get_gid() == "body:coupler"][-2]
        np.testing.assert_allclose(center(circle), socket[[i, j]], atol=1e-12)
        assert (ax.get_xlabel(), ax.get_ylabel()) == (f"{'xyz'[i]} [mm]", f"{'xyz'[j]} [mm]")


def test_traces_follow_the_points_up_to_the_time(run):
    figure = sj.draw(run, 0.05, view=(0, 0), traces=["rocker"])
    line = figure.axes[0].lines[0]
    expected = camera_from(0, 0, DOWN).project(np.asarray(run.position("rocker"))[:6])
    np.testing.assert_allclose(line.get_xydata(), expected, atol=1e-12)


def test_between_samples_the_motion_is_interpolated_by_its_rates():
    run = sj.simulate(
        pendulum(velocity=(0.0, 0.3, 0.0), angular_velocity=(0.0, 0.0, 1.0)), jnp.linspace(0.0, 0.4, 9), rtol=1e-9
    )
    every_second = mechanism_of(jax.tree.map(lambda x: x[::2] if jnp.shape(x)[:1] == (9,) else x, run))
    assert len(every_second.ts) == 5
    for sample in (1, 3, 5, 7):
        pose = every_second.pose(float(run.ts[sample]))
        # Hermite: h^4 / 384 times the fourth derivative, some 400 m/s^4, for h = 0.1 s. Straight lines: 1e-2 m.
        np.testing.assert_allclose(pose.positions["bob"], run.position("bob")[sample], atol=1e-4)
        assert abs(pose.quaternions["bob"] @ np.asarray(run.quaternion("bob")[sample])) == pytest.approx(1, abs=1e-8)
        turned = pose.rotations["bob"]
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)


def test_springs_and_arrows_carry_their_names():
    scene = sj.gallery.governor()
    assert set(scene.forces) <= {text.get_text() for text in labels(sj.draw(scene))}
    bob = sj.Body(1.0, (1e-2,) * 3, points={"top": (0, 0, 0.3)})
    joints = {"hinge": sj.Revolute(("ground", "bob"), (0, 0, 0.3), (0, 1, 0))}
    pull = {"pull": sj.AppliedWrench("bob", force=sj.functions.Constant((9.0, 0.0, 0.0)))}
    # What turns about a joint and is called like it says so once.
    damper = {"hinge": sj.TorsionalSpring(("ground", "bob"), (0, 1, 0), damping=1.0)}
    figure = sj.draw(sj.Scene({"bob": bob}, joints, {**pull, **damper}))
    assert sorted(text.get_text() for text in labels(figure)) == ["bob", "hinge", "pull"]


def test_the_height_of_a_body_is_marked():
    from spherejax.output.plot.heights import with_height

    scene = sj.gallery.four_bar()
    figure = with_height(scene, "rocker", "so high")
    (text,) = [text for text in figure.axes[0].texts if text.get_gid() == "height"]
    height = float(scene.bodies["rocker"].position[2])  # the assembly moves it by some micrometers
    assert float(text.get_text().split()[2]) == pytest.approx(1e3 * height, abs=0.02)
    (mark,) = [one for one in figure.axes[0].texts if getattr(one, "arrow_patch", None) and not one.get_text()]
    assert np.linalg.norm(np.subtract(mark.xyann, mark.xy)) <= height + 2e-5  # a parallel projection
    with pytest.raises(sj.SceneError, match="no body 'rokcer'"):
        with_height(scene, "rokcer", "")


def test_labels_are_there_and_do_not_overlap():
    bodies, joints = {}, {}
    for i in range(12):
        bodies[f"link_{i}"] = sj.Body(
            0.1,
            (1e-5, 1e-5, 1e-6),
            position=(-0.05 - 0.1 * i, 0, 0),
            points={"top": (0.05, 0, 0), "end": (-0.05, 0, 0)},
        )
        joints[f"joint_{i}"] = sj.Spherical(f"link_{i - 1}.end" if i else "ground.hook", f"link_{i}.top")
    figure = sj.draw(sj.Scene(bodies, joints, ground_points={"hook": (0, 0, 0)}))
    figure.canvas.draw()
    written = labels(figure)
    assert {text.get_text() for text in written} == {*bodies, *joints}
    boxes = [np.asarray(Text.get_window_extent(text)) for text in written]  # of the words, without the line to them
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert np.any(a[1] <= b[0]) or np.any(b[1] <= a[0])
    assert not labels(sj.draw(sj.Scene(bodies, joints, ground_points={"hook": (0, 0, 0)}), labels=False))


def test_a_free_body_is_the_box_with_its_inertia():
    sides = np.array([0.3, 0.2, 0.1])
    squares = sides**2
    brick = sj.Body(2.0, 2.0 * (squares.sum() - squares) / 12, position=(1.0, 2.0, 3.0))
    figure = sj.draw(sj.Scene({"brick": brick}), projections=True)
    panels = {ax.get_title(loc="left"): ax for ax in figure.axes}
    front = np.concatenate([p.get_path().vertices for p in panels["front"].patches][:6])
    np.testing.assert_allclose(front.min(axis=0), [1 - 0.15, 3 - 0.05], atol=1e-12)
    np.testing.assert_allclose(front.max(axis=0), [1 + 0.15, 3 + 0.05], atol=1e-12)


def test_frames_are_the_axes_of_the_body(run):
    figure = sj.draw(run, 0.1, view=(30, 20), frames=True)
    pose = mechanism_of(run).pose(0.1)
    camera = camera_from(30, 20, DOWN)
    arms = [path[1] - path[0] for path in paths(figure, "frame:rocker")]
    axes = camera.project(pose.rotations["rocker"].T)
    length = np.linalg.norm(arms[0]) / np.linalg.norm(axes[0])
    np.testing.assert_allclose(arms, length * axes, atol=1e-12)
    assert not names(sj.draw(run, 0.1), "frame:")


def test_ground_is_below_what_stands_and_above_what_hangs(scene):
    standing = sj.draw(scene)
    base = np.nanmin(np.concatenate(paths(standing, "ground:rocker_pivot"))[:, 1])
    assert base < center(paths(standing, "joint:rocker_pivot")[1])[1]
    hanging = sj.draw(pendulum())
    assert np.nanmax(np.concatenate(paths(hanging, "ground:hook"))[:, 1]) > 0
    assert np.nanmin(np.concatenate(paths(hanging, "ground:hook"))[:, 1]) == pytest.approx(0.0)


def test_up_is_opposite_to_gravity():
    front, side, top = three_projections(np.array([0.0, -9.81, 0.0]))
    np.testing.assert_array_equal(front.up, [0, 1, 0])
    np.testing.assert_array_equal(front.right, [1, 0, 0])
    for one in (front, side, top):
        assert np.linalg.norm(one.toward) == pytest.approx(1.0)
    np.testing.assert_array_equal(three_projections(np.array([0.0, 0.0, 9.81]))[0].up, [0, 0, -1])
    np.testing.assert_array_equal(three_projections(np.zeros(3))[0].up, [0, 0, 1])


def test_a_plane_mechanism_is_seen_from_its_front():
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 0.0, 0.7]])
    camera = best_camera(flat, DOWN)
    np.testing.assert_array_equal(np.abs(camera.toward), [0, 1, 0])
    spatial = best_camera(np.vstack([flat, [[0.0, 1.0, 0.2]]]), DOWN)
    assert np.abs(spatial.toward).max() < 0.99
    assert spatial.up[2] > 0.9


def test_an_applied_force_is_an_arrow_and_a_named_point_is_part_of_the_body():
    scene = pendulum()
    pushed = sj.Scene(
        scene.bodies,
        scene.joints,
        {"push": sj.AppliedWrench("bob", force=(2.0, 0, 0))},
        ground_points={"hook": (0, 0, 0)},
    )
    arrow = paths(sj.draw(pushed, view=(-90, 0)), "force:push")[0]
    tip, tail = arrow[3], arrow[0]
    np.testing.assert_allclose(tip, [0.3, -0.4], atol=1e-12)
    assert tail[0] < tip[0]
    assert tail[1] == pytest.approx(tip[1])
    tipped = pendulum()
    tipped = sj.Scene(
        {"bob": sj.Body(1.0, (1e-3,) * 3, (0.3, 0, -0.4), points={"hook": (-0.3, 0, 0.4), "tip": (0.3, 0.0, -0.4)})},
        tipped.joints,
        ground_points={"hook": (0, 0, 0)},
    )
    bar = paths(sj.draw(tipped, view=(-90, 0)), "body:bob")[1]
    np.testing.assert_allclose(sorted(bar.tolist()), [[0.0, 0.0], [0.6, -0.8]], atol=1e-12)
    run = sj.simulate(tipped, jnp.array([0.0, 0.01]))
    assert len(paths(sj.draw(run), "body:bob")) > len(paths(sj.draw(run, scene=tipped), "body:bob"))


def test_the_convex_hull_is_the_outline():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 2.0], [1.0, 0.5]])
    assert {tuple(row) for row in convex_hull(square)} == {(0, 0), (2, 0), (2, 2), (0, 2)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"t": 0.2}, r"t = 0.2 s lies outside of the motion, 0 s to 0.1 s"),
        ({"t": float("nan")}, "lies outside of the motion"),
        ({"traces": ["rocket"]}, "there is no body or joint 'rocket' to trace; there are 'coupler'"),
        ({"view": (30,)}, "must be azimuth and elevation in degrees"),
        ({"view": (30, np.inf)}, "must be azimuth and elevation in degrees"),
        ({"scene": pendulum()}, "is not the scene of this run"),
    ],
)
def test_a_bad_request_is_named(run, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.draw(run, **options)


def test_what_cannot_be_drawn_is_named(run):
    with pytest.raises(sj.SceneError, match="ndarray cannot be drawn; give a Scene"):
        sj.draw(np.zeros(3))  # pyright: ignore[reportArgumentType]
    lanes = jax.tree.map(lambda x: jnp.stack([x, x]), run)
    with pytest.raises(sj.SceneError, match="take one lane of it"):
        sj.draw(lanes)


def test_a_failed_run_is_drawn_as_far_as_it_went(run):
    ys = run.ys.at[6:].set(jnp.nan)
    ended = (ys, jnp.asarray(0.055), jnp.asarray(int(sj.Status.TOO_MANY_STEPS)))
    failed = eqx.tree_at(lambda one: (one.ys, one.t_reached, one.ended), run, ended)
    assert failed.diagnosis
    assert sj.draw(failed, 0.05).get_suptitle() == "t = 0.0500 s"
    with pytest.raises(sj.SceneError, match=r"0 s to 0.05 s; stopped at t = 0.055 s of 0.1 s"):
        sj.draw(failed, 0.06)


# Magnified joints ------------------------------------------------------------------------------------------------


def magnified(figure: Figure):
    return next(ax for ax in figure.axes if "magnified" in ax.get_title())


def ball(ax):
    return np.ravel(next(line for line in ax.lines if str(line.get_gid()).startswith("ball:")).get_xydata())


@pytest.mark.parametrize("sample", [2, 10])
def test_the_ball_is_drawn_at_its_eccentricity_inside_the_clearance_circle(run, sample):
    figure = sj.draw(run, float(run.ts[sample]), plane=(0, -1, 0))
    ax = magnified(figure)
    e = np.asarray(run.eccentricity("coupler_rocker")[sample])
    expected = e[[0, 2]] * np.linalg.norm(e) / np.linalg.norm(e[[0, 2]])
    np.testing.assert_allclose(ball(ax), expected, atol=1e-12)
    circle = next(line for line in ax.lines if line.get_gid() == "circle").get_xydata()
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 1e-4)
    words = ax.texts[0].get_text()
    assert f"|e| = {1e3 * np.linalg.norm(e):.4f} mm = {np.linalg.norm(e) / 1e-4:.3f} c" in words
    force = float(np.linalg.norm(run.reaction("coupler_rocker")[sample]))
    touches = np.linalg.norm(e) >= 1e-4
    assert ("contact" in words) == touches
    assert (f"force on the ball: {force:.3g} N" in words) == (force > 0)
    assert next(patch for patch in ax.patches if patch.get_gid() == "normal").get_visible() == touches


def test_the_magnification_is_that_of_the_paper(run):
    figure = sj.draw(run, 0.1)
    figure.canvas.draw()
    joint, space = magnified(figure), figure.axes[0]
    per_meter = [ax.get_window_extent().width / np.ptp(ax.get_xlim()) for ax in (joint, space)]
    stated = float(joint.get_title().split("magnified ")[1].split(" times")[0].replace(",", ""))
    assert stated == pytest.approx(per_meter[0] / per_meter[1], rel=0.05)


def test_the_plane_holds_most_of_the_path(run):
    turned = np.array([[0.0, 0.0, 0.0], [3.0, 0.1, 4.0], [-2.0, 0.1, 1.0]])
    motion = JointMotion("joint", np.arange(3.0), 1e-5 * turned, None, 1e-4)
    camera = plane_of(motion, DOWN, None, np.array([0.0, -1.0, 0.2]))
    np.testing.assert_array_equal(camera.toward, [0, -1, 0])
    np.testing.assert_array_equal(camera.up, [0, 0, 1])
    level = plane_of(motion, DOWN, (0, 0, 2), np.array([0.0, -1.0, 0.2]))
    np.testing.assert_array_equal(level.toward, [0, 0, 1])
    assert not [ax for ax in sj.draw(run, 0.1, magnified=()).axes if "magnified" in ax.get_title()]


def test_a_bushing_has_a_circle_of_its_largest_eccentricity():
    ax = magnified(sj.draw(sj.gallery.four_bar(sj.Bushing(1e5, 1e-3)), magnified="coupler_rocker"))
    assert "largest |e|" in ax.texts[0].get_text()
    assert "force" not in ax.texts[0].get_text()
    path = 1e-6 * np.array([[3.0, 0.0, 4.0], [0.0, 1.0, 0.0]])
    assert JointMotion("bushing", np.arange(2.0), path, None, None).radius == pytest.approx(5e-6)
    assert JointMotion("dry", np.arange(2.0), path, None, 1e-4).radius == 1e-4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"magnified": ["crank_pivot"]}, "'crank_pivot' has no clearance or bushing to magnify; .*'coupler_rocker'"),
        ({"magnified": ["elbow"]}, "'elbow' is no joint"),
        ({"plane": (0, 0, 0)}, "must be the normal of a plane"),
    ],
)
def test_a_joint_that_cannot_be_magnified_is_named(run, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.draw(run, 0.1, **options)


# Films -----------------------------------------------------------------------------------------------------------


def test_a_gif_has_its_frames_its_length_and_its_times(run, tmp_path):
    shares = []
    path = sj.animate(
        run, tmp_path / "films" / "motion.gif", fps=10, slow=10, dpi=50, report=lambda what, share: shares.append(share)
    )
    with Image.open(path) as film:
        assert film.n_frames == 11
        assert film.info["duration"] == 100  # ms
        first = np.asarray(film.convert("RGB"))
        film.seek(10)
        last = np.asarray(film.convert("RGB"))
    assert tuple(first[first.shape[0] // 2, 3]) == (255, 255, 255)
    assert np.mean(np.any(first != last, axis=-1)) > 0.005
    assert shares == pytest.approx(np.arange(1, 12) / 11)


def test_every_frame_shows_the_mechanism_at_its_time(run):
    sheet = Sheet(mechanism_of(run), poses_of(mechanism_of(run)), Wishes(view=(40, 15)), pace="real time", dpi=50)
    pose = sheet.mechanism.pose(0.04)
    sheet.update(pose)
    alone = sj.draw(run, 0.04, view=(40, 15))
    for name in ("body:rocker", "joint:crank_coupler"):
        for moved, still in zip(paths(sheet.figure, name), paths(alone, name), strict=True):
            np.testing.assert_allclose(center(moved), center(still), atol=1e-12)
    assert sheet.figure.get_suptitle() == "t = 0.0400 s, real time"
    np.testing.assert_allclose(ball(magnified(sheet.figure)), ball(magnified(alone)), atol=1e-12)


def test_the_pace_is_what_the_frames_do(run):
    mechanism = mechanism_of(run)
    times = frame_times(mechanism, 0.04, 20.0)
    np.testing.assert_allclose(np.diff(times), 0.002)
    assert (times[0], times[-1]) == (0.0, pytest.approx(0.1))
    assert pace_in_words(20.0) == "slowed down 20 times"
    assert pace_in_words(0.5) == "speeded up 2 times"
    assert [usual_pace(duration) for duration in (0.05, 0.5, 6.0, 100.0)] == [100, 10, 1, pytest.approx(0.05)]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("motion.avi", {}, "'.avi' names no film; use .gif or .mp4"),
        ("motion.gif", {"fps": 0.0}, "fps = 0 must be positive"),
        ("motion.gif", {"slow": -1.0}, "slow = -1 must be positive"),
        ("motion.gif", {"slow": 1e6}, "2,500,001 frames are too many"),
        ("motion.gif", {"magnified": ["elbow"]}, "'elbow' is no joint"),
    ],
)
def test_a_film_that_cannot_be_made_is_named(run, tmp_path, name, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.animate(run, tmp_path / name, **options)
    assert not (tmp_path / name).exists()


def test_a_film_is_not_written_over_and_needs_a_motion(run, tmp_path):
    path = tmp_path / "motion.gif"
    path.write_text("precious")
    with pytest.raises(sj.SceneError, match="exists"):
        sj.animate(run, path)
    assert path.read_text() == "precious"
    still = jax.tree.map(lambda x: x[:1] if jnp.shape(x)[:1] == (11,) else x, run)
    with pytest.raises(sj.SceneError, match="one sample is no motion"):
        sj.animate(still, tmp_path / "still.gif")


def test_an_mp4_without_ffmpeg_names_the_remedy(run, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(sj.SceneError, match=r"pip install 'spherejax\[video\]', or write a GIF"):
        sj.animate(run, tmp_path / "motion.mp4")


def test_an_mp4_has_its_frames_and_its_length(run, tmp_path):
    try:
        program = ffmpeg()
    except sj.SceneError:
        pytest.skip("neither ffmpeg nor imageio-ffmpeg is installed")
    path = sj.animate(run, tmp_path / "motion.mp4", fps=30, slow=10, dpi=51)
    seen = subprocess.run([program, "-i", path, "-f", "null", "-"], capture_output=True, text=True, check=True).stderr
    assert "h264" in seen
    assert re.findall(r"frame= *(\d+)", seen)[-1] == "31"
    assert "Duration: 00:00:01.03" in seen
    blocked = tmp_path / "folder.mp4"
    blocked.mkdir()
    with pytest.raises(sj.SceneError, match=r"cannot write .*folder.mp4.*Is a directory"):
        sj.animate(run, blocked, overwrite=True, dpi=51)


# Kinds of joints and force elements ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kinds():
    def body(x):
        return sj.Body(1.0, (1e-2, 1e-2, 1e-3), position=(x, 0, -0.2), points={"a": (0, 0, 0.2), "b": (0, 0, -0.2)})

    joints = {
        "cylindrical": sj.Cylindrical(("ground", "b0"), (0, 0, 0), (0, 0, 1)),
        "prismatic": sj.Prismatic(("ground", "b1"), (0.5, 0, 0), (1, 0, 0)),
        "universal": sj.Universal(("ground", "b2"), (1.0, 0, 0), (1, 0, 0), (0, 1, 0)),
        "fixed": sj.Fixed(("ground", "b3"), (1.5, 0, 0)),
        "plane": sj.joints.PointOnPlane("b4.a", (0.0, 0, 0), (0, 0, 1)),
        "revolute": sj.Revolute(("ground", "b5"), (2.5, 0, 0), (0, 1, 0)),
        "driver": sj.RotationDriver(("ground", "b5"), (0, 1, 0), lambda t: 2 * t),
        "distance": sj.joints.Distance("b3.b", "b4.b"),
        "drive": sj.joints.PositionDriver("b6.a", lambda t: jnp.stack([3.0 + t, 0 * t, 0 * t])),
    }
    forces = {
        "spring": sj.SpringDamper(("b0.b", "b1.b"), stiffness=100.0),
        "twist": sj.TorsionalSpring(("ground", "b5"), (0, 1, 0), stiffness=1.0),
        "tyre": sj.forces.Tyre("b4.b", 0.15, stiffness=1e4, speed=1.0, road=sj.functions.Sine(0.05, 1.0)),
    }
    return sj.Scene({f"b{i}": body(0.5 * i) for i in range(7)}, joints, forces)


def test_every_kind_has_its_own_symbol(kinds):
    drawn = mechanism_of(kinds).joints
    assert {name: joint.kind for name, joint in drawn.items()} == {
        "cylindrical": "Cylindrical", "prismatic": "Prismatic", "universal": "Universal", "fixed": "Fixed",
        "plane": "PointOnPlane", "revolute": "Revolute", "driver": "RotationDriver", "distance": "Distance",
        "drive": "PositionDriver",
    }  # fmt: skip
    assert {joint.kind for joint in drawn.values()} <= set(SYMBOLS)
    assert len({SYMBOLS[joint.kind] for joint in drawn.values()}) == len(drawn)
    words = {text.get_text() for ax in sj.draw(kinds).axes for text in ax.texts if text.get_gid() == "key"}
    assert words == {
        "cylindrical", "prismatic", "universal", "fixed", "point on plane", "revolute", "rotation driver", "distance",
        "position driver",
    }  # fmt: skip


def test_joints_of_directions_have_symbols_along_them():
    def body(x):
        return sj.Body(1.0, (1e-2, 1e-2, 1e-2), position=(x, 0, 0))

    joints = {
        "same": sj.joints.SameOrientation(("ground", "a"), (0.2, 0, 0)),
        "parallel": sj.joints.ParallelAxes(("a", "b"), (0.6, 0, 0), (1, 0, 1)),
        "perpendicular": sj.joints.PerpendicularAxes(("b", "c"), (1.2, 0, 0), (1, 0, 0), (0, 0, 1)),
    }
    scene = sj.Scene({"a": body(0.3), "b": body(0.9), "c": body(1.5)}, joints)
    drawn = mechanism_of(scene).joints
    assert {joint.kind for joint in drawn.values()} <= set(SYMBOLS) & set(turning.SYMBOLS)
    figure = sj.draw(scene, view=(-90, 0))
    for name, directions in (("parallel", [[1, 1], [1, 1]]), ("perpendicular", [[1, 0], [0, 1]])):
        lines = [line for line in paths(figure, f"joint:{name}") if len(line) == 2]
        for line, direction in zip(lines, directions, strict=True):
            along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
            np.testing.assert_allclose(along, np.array(direction) / np.linalg.norm(direction), atol=1e-9)
    assert len(paths(figure, "joint:same")) == 2


def test_symbols_are_where_the_joints_are(kinds):
    figure = sj.draw(kinds, view=(-90, 0))
    where = {"prismatic": (0.5, 0.0), "universal": (1.0, 0.0), "plane": (2.0, 0.0), "drive": (3.0, 0.0)}
    for name, place in where.items():
        outline = np.concatenate(paths(figure, f"joint:{name}"))
        outline = outline[np.isfinite(outline).all(axis=1)]
        np.testing.assert_allclose(center(outline)[0], place[0], atol=1e-3)
    link = paths(figure, "joint:distance")[1]
    np.testing.assert_allclose(link, [[1.5, -0.4], [2.0, -0.4]], atol=1e-12)
    assert names(figure, "ground:") == {"cylindrical", "prismatic", "universal", "fixed", "revolute"}
    arc = paths(figure, "joint:driver")[0]
    assert np.linalg.norm(center(arc) - [2.5, 0.0]) < 0.05


def test_springs_join_their_points_and_a_tyre_stands_over_its_road(kinds):
    figure = sj.draw(kinds, view=(-90, 0))
    spring = paths(figure, "force:spring")[1]
    np.testing.assert_allclose(spring[[0, -1]], [[0.0, -0.4], [0.5, -0.4]], atol=1e-12)
    circle, road = paths(figure, "force:tyre")
    np.testing.assert_allclose(np.linalg.norm(circle - [2.0, -0.4], axis=1), 0.15, atol=1e-9)
    np.testing.assert_allclose(road[:, 1], 0.05 * np.sin(2 * np.pi * road[:, 0]), atol=1e-9)
    spiral = paths(figure, "force:twist")[0]
    assert np.linalg.norm(center(spiral) - [2.5, 0.0]) < 0.05


def test_a_box_does_not_hide_the_mechanism():
    scene = sj.Scene(
        {
            "rod": sj.Body(
                1.0, (1e-2, 1e-2, 1e-3), position=(0, 0, -0.2), points={"a": (0, 0, 0.2), "b": (0, 0, -0.2)}
            ),
            "mass": sj.Body(1.0, (1.0, 1.0, 1.0), position=(0, 0, -0.4), points={"center": (0, 0, 0)}),
        },
        {
            "hook": sj.Spherical("ground.hook", "rod.a"),
            "end": sj.Spherical("rod.b", "mass.center"),
        },
        ground_points={"hook": (0, 0, 0)},
    )
    box = np.concatenate(paths(sj.draw(scene, view=(-90, 0)), "body:mass")[:6])
    assert np.ptp(box[:, 0]) < 0.1


def test_the_arm_of_a_circle_runs_from_its_center_to_its_point():
    scene = sj.Scene(
        {"ball": sj.Body(1.0, (1e-3,) * 3, position=(1.0, 0.0, 0.5), points={"eye": (0.0, 0.0, 0.0)})},
        {"arm": sj.joints.PointOnCurve("ball.eye", sj.joints.Circle((0.0, 0.0, 0.5), (0, 0, 1), 1.0))},
    )
    assert mechanism_of(scene).joints["arm"].kind == "PointOnCircle"
    arm = paths(sj.draw(scene, view=(-90, 0)), "joint:arm")[1]
    np.testing.assert_allclose(arm, [[0.0, 0.5], [1.0, 0.5]], atol=1e-12)


def test_a_motor_along_a_line_is_a_cylinder_that_hides_no_body():
    """A controller between two points is drawn without a zigzag, and without the paper-colored line beneath one.

    So it is in reports, whose pictures can be turned.
    """
    bob = sj.Body(1.0, (1e-2,) * 3, points={"top": (0, 0, 0.3)})
    leg = sj.PID(sj.Extension(("ground.hook", "bob.top")), 0.5, 100.0, 1.0)
    spring = sj.SpringDamper(("ground.hook", "bob.top"), 100.0)
    scene = sj.Scene({"bob": bob}, {}, {"leg": leg, "spring": spring}, ground_points={"hook": (0, 0, 1.0)})
    figure = sj.draw(scene, view=(-90, 0))
    assert [len(path) for path in paths(figure, "force:leg")][:4] == [2, 5, 2, 2]
    assert len(paths(figure, "force:spring")[0]) == 16
    links = [shape for shape in viewed(scene, "scene")["shapes"] if shape["kind"] == "link"]
    assert [set(shape) & {"barrel", "zigzag"} for shape in links] == [{"barrel"}, {"zigzag"}]
