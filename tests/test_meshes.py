"""Bodies from meshes: against closed forms, and refusals of what encloses no solid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj

trimesh = pytest.importorskip("trimesh")

EDGES = (0.2, 0.1, 0.05)


def box(at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(extents=EDGES)
    mesh.apply_translation(at)
    return mesh


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (5.0, -6.0, 7.0)])
def test_a_box_is_exact_wherever_it_was_drawn(at):
    body, exact = sj.Body.from_mesh(box(at), unit="m", density=2700.0), sj.Body.box(EDGES, density=2700.0)
    np.testing.assert_allclose(body.mass, exact.mass, rtol=1e-12)
    np.testing.assert_allclose(body.inertia, exact.inertia, rtol=1e-12)
    np.testing.assert_allclose(body.position, at, atol=1e-14)


def test_a_tetrahedron_has_the_moments_of_one():
    """On the unit axes: V = 1/6, center 1/4; about it the integral of x^2 is V 3/80, of x y -V/80."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    body = sj.Body.from_mesh(trimesh.Trimesh(corners, faces), unit="m", density=6.0)
    assert body.mass == pytest.approx(1.0, rel=1e-14)
    np.testing.assert_allclose(body.position, 0.25, rtol=1e-14)
    np.testing.assert_allclose(body.inertia, np.full((3, 3), 1 / 80) + np.eye(3) * (6 / 80 - 1 / 80), rtol=1e-13)


def test_balls_of_triangles_tend_to_a_ball():
    """Four times the triangles, a quarter of the error."""
    exact = sj.Body.sphere(0.05, density=1000.0)
    errors = []
    for n in (2, 3, 4):
        body = sj.Body.from_mesh(trimesh.creation.icosphere(n), unit=0.05, density=1000.0)
        errors.append([1 - body.mass / exact.mass, 1 - body.inertia[0] / exact.inertia[0]])
        np.testing.assert_allclose(body.inertia, body.inertia[0], rtol=1e-12)
    errors = np.array(errors)
    assert errors[-1].max() < 4e-3
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.03)


def test_units_files_and_places(tmp_path):
    """An STL file in millimeters, drawn off its origin and turned."""
    mesh = box((0.3, 0.0, 0.0))
    mesh.apply_scale(1000.0)
    path = tmp_path / "link.stl"
    mesh.export(path)
    turn, place = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]), np.array([1.0, 2.0, 3.0])
    points = {"pin": (0.0, 0.0, 0.0), "tip": (0.4, 0.0, 0.0)}
    body = sj.Body.from_mesh(path, unit="mm", mass=3.0, position=place, quaternion=turn, points=points)
    # STL has 32 bits for a number.
    np.testing.assert_allclose(body.inertia, sj.Body.box(EDGES, mass=3.0).inertia, rtol=1e-6)
    np.testing.assert_allclose(body.position, place + np.array([0.0, 0.3, 0.0]), atol=1e-6)
    np.testing.assert_allclose(body.points["pin"], [-0.3, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(body.points["tip"], [0.1, 0.0, 0.0], atol=1e-7)
    assert body.mass == 3.0


def test_a_cavity_is_a_shell_that_looks_inward():
    inner = trimesh.creation.box(extents=(0.1, 0.05, 0.02))
    inner.invert()
    hollow = sj.Body.from_mesh(trimesh.util.concatenate([box(), inner]), unit="m", density=1000.0)
    whole, hole = sj.Body.box(EDGES, density=1000.0), sj.Body.box((0.1, 0.05, 0.02), density=1000.0)
    np.testing.assert_allclose(hollow.mass, whole.mass - hole.mass, rtol=1e-12)
    np.testing.assert_allclose(hollow.inertia, whole.inertia - hole.inertia, rtol=1e-12)


def test_density_and_place_can_be_differentiated():
    def moment(density, x):
        body = sj.Body.from_mesh(box((1.0, 0.0, 0.0)), unit="m", density=density, position=jnp.stack([x, 0.0, 0.0]))
        return body.mass * body.position[0] ** 2 + body.inertia[2]

    slopes = jax.jacobian(moment, (0, 1))(1000.0, 0.5)
    exact = sj.Body.box(EDGES, density=1.0)
    np.testing.assert_allclose(slopes[0], exact.mass * 1.5**2 + exact.inertia[2], rtol=1e-12)
    np.testing.assert_allclose(slopes[1], 1000.0 * exact.mass * 2 * 1.5, rtol=1e-12)


def opened():
    mesh = box()
    return trimesh.Trimesh(mesh.vertices, mesh.faces[1:])


def inverted():
    mesh = box()
    mesh.invert()
    return mesh


def mixed():
    mesh = box()
    faces = np.array(mesh.faces)
    faces[0] = faces[0][::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def flat():
    faces = [[0, 1, 2], [0, 2, 1]]
    return trimesh.Trimesh(np.eye(3), faces, process=False)


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (opened, {"unit": "m"}, r"the mesh is open: 3 of 18 edges have triangles on one side alone.*fill_holes"),
        (inverted, {"unit": "m"}, r"is inside out: its triangles look inward and enclose -0.001 m\^3.*mesh.invert\(\)"),
        (mixed, {"unit": "m"}, r"look to different sides of its surface, at 3 edges; turn them with mesh.fix_normals"),
        (flat, {"unit": "m"}, "encloses no volume"),
        (box, {"unit": "mil"}, "unit = 'mil' is unknown"),
        (box, {"unit": -1.0}, "unit = -1.0 must be a name like 'mm', or its length in meters"),
        (box, {"unit": "m", "mass": 1.0}, "give mass= .* or density= .*, not both"),
        (lambda: "no.stl", {"unit": "m"}, "'no.stl': there is no such file"),
        (lambda: 3.0, {"unit": "m"}, "float is no mesh; give a path"),
    ],
)
def test_what_encloses_no_solid_is_refused(make, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.Body.from_mesh(make(), density=1.0, **options)


def test_a_file_that_is_no_mesh_and_a_missing_library_are_named(tmp_path, monkeypatch):
    path = tmp_path / "no.stl"
    path.write_text("no mesh")
    with pytest.raises(sj.SceneError, match=r"no.stl' (cannot be read|has no triangles)"):
        sj.Body.from_mesh(path, unit="m", density=1.0)
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(sj.SceneError, match=r"pip install 'spherejax\[mesh\]'"):
        sj.Body.from_mesh(box(), unit="m", density=1.0)
