"""Equations that depend on others are counted and named, and so are singular configurations."""

import numpy as np
import pytest
from test_hard_systems import PARALLEL, UNEQUAL, planar_loop

import spherejax as sj

FLAT = ((0, 0, 0), (0.3, 0, 0), (0.8, 0, 0), (0.5, 0, 0))
ALL = ("a", "b", "c", "d")


@pytest.mark.parametrize(
    ("pins", "rank", "is_singular"), [(UNEQUAL, 17, False), (PARALLEL, 17, False), (FLAT, 16, True)]
)
def test_planar_loops(pins, rank, is_singular):
    report = sj.constraint_report(planar_loop(pins))
    assert (report.n_equations, report.rank) == (20, rank)
    assert report.degrees_of_freedom == 18 - rank
    assert report.n_redundant == 20 - rank
    assert report.redundant_joints == ALL
    assert report.is_singular == is_singular
    assert "'a', 'b', 'c', 'd'" in str(report)
    assert ("singular" in str(report)) == is_singular


def test_bricard_mechanism_moves_against_the_count():
    """Six revolutes, five rods: 30 equations for 30 velocities, and one degree of freedom nevertheless."""
    scene = sj.gallery.bricard()
    report = sj.constraint_report(scene)
    assert (report.n_equations, report.rank, report.degrees_of_freedom) == (30, 29, 1)
    assert set(report.redundant_joints) == set(scene.joints)
    assert not report.is_singular


def test_only_joints_of_the_loop_are_named():
    """A pendulum on the loop's coupler has nothing to do with the redundancy."""
    scene = planar_loop(UNEQUAL)
    bob = sj.Body(1.0, (0.1, 0.1, 0.1), position=(0.25, 0.1, 0.3))
    hook = sj.Universal(("coupler", "bob"), (0.25, 0.0, 0.3), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    report = sj.constraint_report(sj.Scene({**scene.bodies, "bob": bob}, {**scene.joints, "hook": hook}))
    assert (report.n_equations, report.rank, report.degrees_of_freedom) == (24, 21, 3)
    assert report.redundant_joints == ALL


def test_what_is_not_redundant_is_not_named():
    report = sj.constraint_report(sj.gallery.four_bar(sj.Dry(clearance=1e-4)))
    assert report == sj.results.ConstraintReport(13, 13, 5, (), False)
    assert str(report) == "13 constraint equations of rank 13; 5 degrees of freedom."
    free = sj.constraint_report(sj.Scene({"free": sj.Body(1.0, (1.0, 1.0, 1.0))}))
    assert free == sj.results.ConstraintReport(0, 0, 6, (), False)


def test_a_mechanism_that_does_not_move():
    """A driven pendulum: six equations, nothing is free; driven twice, one equation depends on the other."""
    pair, y = ("ground", "arm"), (0.0, 1.0, 0.0)
    driver = sj.RotationDriver(pair, y, sj.functions.Linear(2.0, 0.3))
    joints = {"pivot": sj.Revolute(pair, (0.0, 0.0, 0.0), y), "motor": driver}
    arm = sj.Body(1.0, (0.1, 0.1, 0.1), position=(0.3, 0.0, 0.0))
    report = sj.constraint_report(sj.Scene({"arm": arm}, joints), t=0.7)
    assert report == sj.results.ConstraintReport(6, 6, 0, (), False)
    twice = sj.constraint_report(sj.Scene({"arm": arm}, {**joints, "second": driver}))
    assert (twice.rank, twice.redundant_joints) == (6, ("motor", "second"))


def test_over_constrained_scenes_that_cannot_close_are_refused():
    """Two motors that ask for different angles."""
    pair, y = ("ground", "arm"), (0.0, 1.0, 0.0)
    joints = {
        "pivot": sj.Revolute(pair, (0.0, 0.0, 0.0), y),
        "one": sj.RotationDriver(pair, y, sj.functions.Linear(2.0, 0.3)),
        "two": sj.RotationDriver(pair, y, sj.functions.Linear(2.0, 0.4)),
    }
    arm = sj.Body(1.0, (0.1, 0.1, 0.1), position=(0.3, 0.0, 0.0))
    with pytest.raises(sj.SceneError, match=r"joint '(one|two)' cannot be closed.*residual"):
        sj.constraint_report(sj.Scene({"arm": arm}, joints))


def door(*more):
    """A door of 10 kg that hangs on a hinge at 0.2 m, and on other joints."""
    hinge = sj.Revolute(("ground", "door"), (0.0, 0.0, 0.2), (0.0, 0.0, 1.0))
    leaf = sj.Body(10.0, (1.0, 1.0, 1.0), (0.5, 0.0, 1.0), points={"top": (-0.5, 0.0, 0.8), "side": (-0.5, 0.0, 0.1)})
    return sj.Scene({"door": leaf}, {"low": hinge, **dict(more)}, ground_points={"top": (0.0, 0.0, 1.8)})


HIGH = "high", sj.Revolute(("ground", "door"), (0.0, 0.0, 1.8), (0.0, 0.0, 1.0))
SLEEVE = "sleeve", sj.Cylindrical(("ground", "door"), (0.0, 0.0, 1.8), (0.0, 0.0, 1.0))
BALL = "ball", sj.Spherical("ground.top", "door.top")


@pytest.mark.parametrize(
    ("scene", "undetermined"),
    [
        (door(), {}),
        (door(HIGH), {"low": ("force", "moment"), "high": ("force", "moment")}),
        (door(SLEEVE), {"low": ("force", "moment"), "sleeve": ("force", "moment")}),
        # Beside a ball the hinge's moments about x and y, too, are a couple of forces by a lever of 1.6 m.
        (door(BALL), {"low": ("force", "moment"), "ball": ("force",)}),
        (sj.gallery.slider_crank(), {}),
    ],
)
def test_reactions_that_the_motion_does_not_determine_are_marked(scene, undetermined):
    run = sj.simulate(scene, np.array([0.0, 0.01]))
    assert run.undetermined_reactions == undetermined
    table = run.to_xarray()
    named = [table[name].attrs.get("not_unique_for") for name in ("reaction", "reaction_moment")]
    parts = [
        ", ".join(j for j in run.undetermined_reactions if p in undetermined[j]) or None for p in ("force", "moment")
    ]
    assert named == parts


def test_the_mark_of_reactions_is_in_files_and_reports(tmp_path):
    run = sj.simulate(door(HIGH), np.array([0.0, 0.01]))
    sj.save(run, tmp_path / "door.nc")
    assert sj.load(tmp_path / "door.nc")["reaction"].attrs["not_unique_for"] == "high, low"
    run.report(tmp_path / "door.html")
    assert "Reactions of joints high, low are not unique" in (tmp_path / "door.html").read_text()


def test_a_sweep_marks_reactions_that_are_not_unique():
    def build(mass):
        scene = door(HIGH)
        leaf = sj.Body(mass, (1.0, 1.0, 1.0), (0.5, 0.0, 1.0))
        return sj.Scene({"door": leaf}, scene.joints)

    kept = sj.sweep(build, {"mass": [1.0, 2.0]}, np.array([0.0, 0.01]), record=["peak reaction.low"], progress=False)
    assert kept.attrs["not_unique_for"] == "low"
    other = sj.sweep(build, {"mass": [1.0, 2.0]}, np.array([0.0, 0.01]), record=["final position.door"], progress=False)
    assert "not_unique_for" not in other.attrs
