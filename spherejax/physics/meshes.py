"""Volume, center and moments of a solid inside a closed surface of triangles.

Each triangle (a, b, c) and the origin span a tetrahedron of signed volume V = a . (b x c)/6, with

    integral of x = V s/4,    integral of x x^T = V (a a^T + b b^T + c c^T + s s^T)/20,    s = a + b + c

whose sums over a closed surface that looks outward are the integrals over the solid.

Source: B. Mirtich, Fast and accurate computation of polyhedral mass properties, J. Graphics Tools 1 (2), 1996, has the
same integrals by the divergence theorem; the moments of a tetrahedron are elementary.
"""

from collections import Counter
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import visible
from spherejax.foundations.types import Number
from spherejax.physics.solids import mass_of

UNITS_OF_LENGTH = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
"""In meters."""

_FLAT = 1e-12
"""Volume as a share of the box around a surface, below which it encloses nothing but rounding."""

_ROUNDING = 1e-12
"""Products of inertia below this share of the largest moment are rounding of sums over thousands of triangles."""


class MeshSolid(NamedTuple):
    """A solid inside a surface.

    Attributes:
        mass: [kg].
        inertia: about the center of mass, axes of the mesh [kg m^2]; three moments where they are principal.
        center: center of mass from the origin of the mesh [m], shape (3,).
    """

    mass: Number
    inertia: Any
    center: np.ndarray


def mesh_solid(mesh: Any, unit: str | float, mass: Number | None, density: Number | None) -> MeshSolid:
    """The solid inside a mesh.

    Raises:
        SceneError: for a file that cannot be read, a surface that is open, inside out or flat, a unknown unit; for both
            mass and density, or neither; for a missing library.
    """
    what = f"Body.from_mesh: {str(mesh)!r}" if isinstance(mesh, str | PathLike) else "Body.from_mesh: the mesh"
    meters = _meters(unit)
    vertices, faces = _triangles(mesh, what)
    _check_closed(vertices, faces, what)
    # Near the middle nothing cancels, wherever the mesh was drawn.
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    a, b, c = (meters * (vertices[faces[:, k]] - middle) for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume, around = volumes.sum(), np.prod(meters * np.ptp(vertices, axis=0))
    if not abs(volume) > _FLAT * around:
        raise SceneError(f"{what} encloses no volume; give the surface of a solid")
    if volume < 0:
        raise SceneError(
            f"{what} is inside out: its triangles look inward and enclose {volume:.6g} m^3. Turn them with "
            "mesh.invert(), or export it again"
        )
    s = a + b + c
    center = np.einsum("i,ij->j", volumes, s) / 4 / volume
    second = sum(np.einsum("i,ij,ik->jk", volumes, v, v) for v in (a, b, c, s)) / 20
    second = second - volume * np.outer(center, center)
    moments = (np.trace(second) * np.eye(3) - second) / volume
    products = moments - np.diag(np.diag(moments))
    if np.abs(products).max() <= _ROUNDING * np.abs(moments).max():
        moments = np.diag(moments)
    total = mass_of("Body.from_mesh", mass, density, float(volume))
    return MeshSolid(total, total * moments, meters * middle + center)


def _meters(unit: str | float) -> float:
    if isinstance(unit, str):
        if unit not in UNITS_OF_LENGTH:
            raise SceneError(f"Body.from_mesh: unit = {unit!r} is unknown; {one_of(UNITS_OF_LENGTH, unit)}")
        return UNITS_OF_LENGTH[unit]
    if not (isinstance(unit, int | float) and 0 < unit < np.inf):
        raise SceneError(f"Body.from_mesh: unit = {unit!r} must be a name like 'mm', or its length in meters")
    return float(unit)


def _triangles(mesh: Any, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles, with corners at the same place as one."""
    try:
        import trimesh
    except ImportError as error:
        raise SceneError(f"reading meshes needs a library: pip install 'spherejax[mesh]' ({error})") from error
    if isinstance(mesh, str | PathLike):
        path = Path(mesh).expanduser()
        if not path.is_file():
            raise SceneError(f"{what}: there is no such file")
        try:
            mesh = trimesh.load_mesh(path)
        except Exception as error:  # the library's readers raise what they will
            raise SceneError(f"{what} cannot be read: {' '.join(str(error).split())}") from error
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise SceneError(
            f"Body.from_mesh: {type(mesh).__name__} is no mesh; give a path, or an object with vertices and "
            "faces, e.g. a trimesh.Trimesh"
        )
    vertices, faces = np.asarray(visible(mesh.vertices), np.float64), np.asarray(mesh.faces)
    if len(faces) == 0 or not np.all(np.isfinite(vertices)):
        raise SceneError(f"{what} has no triangles, or corners that are not finite")
    whole = trimesh.Trimesh(vertices, faces, process=True)  # merges corners: STL lists them anew for each triangle
    return np.asarray(whole.vertices, np.float64), np.asarray(whole.faces)


def _check_closed(vertices: np.ndarray, faces: np.ndarray, what: str) -> None:
    """Every edge has one triangle on either side, and both look to the same side of the surface.

    Raises:
        SceneError: naming how many edges are open, and where one is; or that triangles look to different sides.
    """
    directed = Counter((int(one), int(two)) for face in faces for one, two in zip(face, np.roll(face, -1), strict=True))
    undirected = Counter(tuple(sorted(edge)) for edge in directed.elements())
    open_edges = [edge for edge, n in undirected.items() if n % 2]
    if open_edges:
        place = np.array2string(vertices[list(open_edges[0])].mean(axis=0), precision=4)
        raise SceneError(
            f"{what} is open: {len(open_edges)} of {len(undirected)} edges have triangles on one side alone, one of "
            f"them at {place}, in its own unit; it encloses no solid. Close it (mesh.fill_holes() closes small holes), "
            "or export the part as a solid"
        )
    turned = sum(directed[one, two] != directed[two, one] for one, two in undirected)
    if turned:
        raise SceneError(
            f"{what} has triangles that look to different sides of its surface, at {turned} edges; turn them with "
            "mesh.fix_normals()"
        )
