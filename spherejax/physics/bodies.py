"""Rigid bodies: inertia, where they start, and named points on them."""

from collections.abc import Mapping
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, concretely, is_concrete
from spherejax.foundations.forms import is_numeric, mapping_of, refuse_masked
from spherejax.foundations.rotation import normalized, rotation_matrix
from spherejax.foundations.types import Matrix3, Moments, Number, Numeric, Quadruple, Triple, Unit, Vector3
from spherejax.physics import meshes, solids
from spherejax.physics.orientations import as_quaternion

GROUND = "ground"
"""The name of the body that does not move; its axes are the world axes."""

SYMMETRY_TOLERANCE = 1e-6
"""How far entries of an inertia matrix that mirror each other may differ, as a share of its largest entry: what turning
it into other axes rounds, and tables of seven digits."""

TRIANGLE_TOLERANCE = 1e-2
"""How far the largest principal moment may exceed the sum of the other two, as a share of it. A flat body has equality,
and three printed digits round each of its moments by up to half a percent."""

UNIT_NORM_TOLERANCE = 1e-3
"""How far a given quaternion may be from unit norm: printed tables carry four digits; it is normalized at the start."""


class Body(eqx.Module):
    """A rigid body: inertia, initial motion, and points by name.

    Attributes:
        mass: mass [kg].
        inertia: about the center of mass in body axes [kg m^2]; shape (3,) for principal axes, or (3, 3), symmetric.
            Positive, and no principal moment larger than the sum of the other two: no body has such moments.
        position: initial position of the center of mass in world axes [m], shape (3,).
        quaternion: initial unit quaternion, scalar first, body axes to world axes, shape (4,). A rotation matrix (3, 3)
            or a `Rotation` of SciPy is taken as one; `sj.orientation` makes one of an axis and an angle, or of angles.
        velocity: initial velocity of the center of mass, world axes [m/s], shape (3,).
        angular_velocity: initial angular velocity, world axes [rad/s], shape (3,).
        points: places on the body where joints and forces meet it, body axes [m], each of shape (3,).
        reference_position, reference_quaternion: where the body is in the position for which joints and forces
            give points, axes and rest angles; None: where it starts. `sj.equilibrium` sets them, so that what was
            described where it was drawn keeps its meaning where the mechanism comes to rest. Of an orientation beyond
            half a turn from there the sign of its quaternion says which way round: q and -q differ by a whole turn.
    """

    mass: Number
    inertia: Moments
    position: Triple = (0.0, 0.0, 0.0)
    quaternion: Quadruple = (1.0, 0.0, 0.0, 0.0)
    velocity: Triple = (0.0, 0.0, 0.0)
    angular_velocity: Triple = (0.0, 0.0, 0.0)
    points: Mapping[str, Triple] = eqx.field(default_factory=dict)
    reference_position: Triple | None = None
    reference_quaternion: Quadruple | None = None

    def __init__(
        self,
        mass: Annotated[Number, Unit("kg")],
        inertia: Annotated[Moments, Unit("kg m^2")],
        position: Annotated[Triple, Unit("m")] = (0.0, 0.0, 0.0),
        quaternion: Annotated[Quadruple, Unit("1")] = (1.0, 0.0, 0.0, 0.0),
        velocity: Annotated[Triple, Unit("m/s")] = (0.0, 0.0, 0.0),
        angular_velocity: Annotated[Triple, Unit("rad/s")] = (0.0, 0.0, 0.0),
        points: Annotated[Mapping[str, Numeric] | None, Unit("m")] = None,
        reference_position: Annotated[Triple, Unit("m")] = None,
        reference_quaternion: Annotated[Quadruple, Unit("1")] = None,
    ):
        self.mass = in_array(mass)
        self.inertia = numbers(inertia)
        self.position = numbers(position)
        self.quaternion = numbers(as_quaternion(quaternion))
        self.velocity = numbers(velocity)
        self.angular_velocity = numbers(angular_velocity)
        points = mapping_of("points", {} if points is None else points, '{"tip": (0.0, 0.0, 0.1)}')
        self.points = {name: numbers(place) for name, place in points.items()}
        self.reference_position = None if reference_position is None else numbers(reference_position)
        self.reference_quaternion = (
            None if reference_quaternion is None else numbers(as_quaternion(reference_quaternion))
        )

    @classmethod
    def box(cls, size, *, mass: Number | None = None, density: Number | None = None, **motion) -> "Body":
        """A homogeneous box, its edges along the body's axes.

        Args:
            size: lengths of the edges along x, y, z [m], shape (3,).
            mass: [kg], or else
            density: [kg/m^3].
            **motion: `position`, `quaternion`, `velocity`, `angular_velocity`, `points`, as of any body.

        Raises:
            SceneError: for both mass and density, or neither; for lengths that are not positive.
        """
        return cls(*solids.box(size, mass, density), **motion)

    @classmethod
    def cylinder(
        cls,
        radius: Number,
        length: Number,
        *,
        axis: str | Triple = "x",
        mass: Number | None = None,
        density: Number | None = None,
        **motion,
    ) -> "Body":
        """A homogeneous cylinder: a shaft, a disc.

            wheel = sj.Body.cylinder(0.3, 0.05, axis="y", mass=8.0)

        Args:
            radius: [m].
            length: [m].
            axis: along which the cylinder lies, body axes: "x", "y", "z", or a vector of any length, shape (3,). About
                a vector the inertia is a matrix.
            mass: [kg], or else
            density: [kg/m^3].
            **motion: as in `box`.

        Raises:
            SceneError: as in `box`; for an axis that is no direction.
        """
        return cls(*solids.cylinder(radius, length, mass, density, axis), **motion)

    @classmethod
    def sphere(cls, radius: Number, *, mass: Number | None = None, density: Number | None = None, **motion) -> "Body":
        """A homogeneous ball.

        Args:
            radius: [m].
            mass: [kg], or else
            density: [kg/m^3].
            **motion: as in `box`.

        Raises:
            SceneError: as in `box`.
        """
        return cls(*solids.sphere(radius, mass, density), **motion)

    @classmethod
    def rod(
        cls,
        ends: Mapping[str, Triple],
        *,
        radius: Number,
        mass: Number | None = None,
        density: Number | None = None,
        points: Mapping[str, Triple] | None = None,
        **motion,
    ) -> "Body":
        """A round rod between two places, which become points of the body; its x axis leads to the second.

            crank = sj.Body.rod({"pin": (0, 0, 0), "tip": (0.02, 0, 0)}, radius=3e-3, density=7850)

        Args:
            ends: two places by name, world axes at the start [m], each of shape (3,).
            radius: [m]; moments are those of a cylinder, for a rod without thickness has none about its axis.
            mass: [kg], or else
            density: [kg/m^3].
            points: further points, body axes from the middle of the rod [m].
            **motion: `velocity`, `angular_velocity`.

        Raises:
            SceneError: as in `box`; for other than two ends, and for two that coincide.
        """
        line = solids.between(ends)
        first, second = line.names
        half = concretely(lambda length: 0.5 * length * jnp.array([1.0, 0.0, 0.0]), line.length)
        solid = solids.cylinder(radius, line.length, mass, density)
        own = {first: -half, second: half, **(points or {})}
        return cls(*solid, position=line.position, quaternion=line.quaternion, points=own, **motion)

    @classmethod
    def from_mesh(
        cls,
        mesh: Any,
        *,
        unit: str | float,
        mass: Number | None = None,
        density: Number | None = None,
        position: Triple = (0.0, 0.0, 0.0),
        quaternion: Quadruple = (1.0, 0.0, 0.0, 0.0),
        points: Mapping[str, Triple] | None = None,
        **motion,
    ) -> "Body":
        """A homogeneous solid inside a closed surface of triangles, its axes those of the mesh.

            link = sj.Body.from_mesh("link.stl", unit="mm", density=2700.0, points={"pin": (0, 0, 0)})

        With `pip install 'spherejax[mesh]'`. Exact for the surface as it is; a curved surface is as good as its
        triangles. Shells inside of others that look inward are cavities; solids that overlap count twice.

        Args:
            mesh: a path (STL, OBJ, PLY, glTF, ...), or an object with `vertices` and `faces`, as `trimesh.Trimesh`.
            unit: of the coordinates in it: "m", "mm", "in", ..., or its length [m]. STL files do not say it.
            mass: [kg], or else
            density: [kg/m^3].
            position: of the mesh's origin, world axes [m], shape (3,); left out, the body is where it was drawn.
            quaternion: as of any body.
            points: from the mesh's origin, in its axes [m], each of shape (3,).
            **motion: `velocity` (of the center of mass), `angular_velocity`.

        Raises:
            SceneError: for a mesh that cannot be read, is open, inside out, or encloses nothing; as in `box`; for a
                missing library.
        """
        solid = meshes.mesh_solid(mesh, unit, mass, density)
        turn = numbers(as_quaternion(quaternion))
        place = concretely(_carried, position, turn, solid.center)
        given = mapping_of("points", {} if points is None else points, '{"tip": (0.0, 0.0, 0.1)}')
        own = {name: numbers(point) - solid.center for name, point in given.items()}
        return cls(solid.mass, solid.inertia, place, turn, points=own, **motion)

    @property
    def in_reference(self) -> "Body":
        """The body where joints and forces are described."""
        position = self.position if self.reference_position is None else self.reference_position
        quaternion = self.quaternion if self.reference_quaternion is None else self.reference_quaternion
        return Body(self.mass, self.inertia, position, quaternion, points=self.points)

    def requirements(self) -> list[Requirement]:
        """What the numbers must satisfy."""
        finite = "be finite numbers"
        remedy = "Check the units (SI) and the source of the number."
        rows = [
            Requirement(
                "mass",
                self.mass,
                (self.mass > 0) & (self.mass < np.inf),
                "be positive [kg]",
                "A massless rod with spherical ends is the joint Distance, a massless arm on a revolute the joint "
                "PointOnCurve with a Circle; any other light part gets a small mass, or is a force element.",
            ),
            *_inertia_requirements(self.inertia),
        ]
        for field in ("quaternion", "reference_quaternion"):
            value = getattr(self, field)
            if value is not None:
                rows.append(unit_norm(field, value))
        for field in ("position", "velocity", "angular_velocity", "reference_position"):
            value = getattr(self, field)
            if value is None:
                continue
            rows.append(Requirement(field, value, abs(value) < np.inf, finite, remedy))
        for name, place in self.points.items():
            rows.append(Requirement(f"points[{name!r}]", place, abs(place) < np.inf, finite, remedy))
        return rows


def _inertia_requirements(inertia: Numeric) -> list[Requirement]:
    """Three moments or a symmetric matrix, positive, that a body can have."""
    form = "Give three principal moments about the center of mass, or a symmetric 3 x 3 matrix, in body axes [kg m^2]."
    is_finite = (abs(inertia) < np.inf).all()
    rows, moments = [Requirement("inertia", inertia, is_finite, "be finite numbers [kg m^2]", form)], inertia
    # Of a matrix that is not finite, or not symmetric, there are no moments to judge.
    if is_concrete(is_finite) and not is_finite:
        return rows
    if np.ndim(inertia) == 2:
        difference, largest = abs(inertia - inertia.T).max(), abs(inertia).max()
        is_symmetric = difference <= SYMMETRY_TOLERANCE * largest
        remedy = "Products of inertia stand twice, with a minus sign: Ixy = -sum m x y in rows and columns 1 and 2."
        rows.append(Requirement("inertia", inertia, is_symmetric, "be symmetric [kg m^2]", remedy))
        if is_concrete(is_symmetric) and not is_symmetric:
            return rows
        moments = concretely(jnp.linalg.eigvalsh, inertia)
    excess = 2 * moments.max() - moments.sum()
    return [
        *rows,
        Requirement("inertia", inertia, moments > 0, "be positive (definite) [kg m^2]", form),
        Requirement(
            "inertia",
            inertia,
            excess <= TRIANGLE_TOLERANCE * moments.max(),
            "obey the triangle rule: no principal moment is larger than the sum of the other two",
            "No body has such moments: their sum is the integral of twice the squared distance from the center. Check "
            "that they are taken about the center of mass, and their units; of a body that is thin or moves in a plane "
            "give the small moments too.",
        ),
    ]


def _carried(position: Triple, quaternion: Quadruple, arm: Triple):
    """A place that a body carries, world axes [m]."""
    return jnp.asarray(position) + rotation_matrix(normalized(quaternion)) @ jnp.asarray(arm)


def unit_norm(field: str, quaternion: Numeric) -> Requirement:
    """A quaternion has length one, but for the digits of a printed table."""
    norm_error = abs((quaternion**2).sum() ** 0.5 - 1)
    remedy = "Divide it by its norm; the scalar part comes first."
    return Requirement(field, quaternion, norm_error < UNIT_NORM_TOLERANCE, "have unit norm", remedy)


def in_array(value: Any) -> Any:
    """A plain number as `np.float64`, anything else as it is.

    That is a `float` as before, known within a trace, and an array to `equinox.filter_grad` and `filter_jit`, which
    would pass over a number of Python.
    """
    kind = type(value)
    if kind is not float and kind is not int:
        return value
    try:
        return np.float64(value)
    except OverflowError:  # it is named with its place when the scene is checked
        return value


def in_arrays(part: Any) -> Any:
    """A joint or a force element whose plain numbers are `np.float64`; one without plain numbers as it is.

    In a user's own module whole numbers may be counts, and stay.
    """
    leaves, tree = jax.tree.flatten(part, is_leaf=_is_foreign)
    arrays = [_of_foreign(leaf) if _is_foreign(leaf) else in_array(leaf) for leaf in leaves]
    has_changed = any(one is not other for one, other in zip(arrays, leaves, strict=True))
    return jax.tree.unflatten(tree, arrays) if has_changed else part


def _of_foreign(module: Any) -> Any:
    has_floats = any(type(leaf) is float for leaf in jax.tree.leaves(module))
    return jax.tree.map(lambda x: np.float64(x) if type(x) is float else x, module) if has_floats else module


def _is_foreign(node: Any) -> bool:
    of = type(node).__module__  # first, for to ask for a class takes longer
    return of not in ("builtins", "numpy") and not of.startswith("spherejax.") and isinstance(node, eqx.Module)


def numbers(value: Any) -> Any:
    """Nested tuples or lists of numbers as one float64 array; arrays and tracers pass.

    Concrete values become NumPy arrays, so that they stay concrete inside an outer trace. What is no numbers stays as
    it is, for NumPy would make numbers of texts: it is named with its place when the scene is checked.

    Raises:
        SceneError: for masked entries: not every field is looked at later, and behind a mask there are numbers.
    """
    if type(value) is tuple and {*map(type, value)} == {float}:  # most are: nothing has to be asked of them
        return np.array(value)
    if not is_numeric(value):
        refuse_masked(value)
        return value
    if isinstance(value, np.ndarray):
        return np.asarray(value, np.float64)
    if hasattr(value, "dtype"):
        return value
    try:
        return np.asarray(value, np.float64)
    except Exception:  # an entry is traced: NumPy refuses it
        return jnp.asarray(value, jnp.float64)


def inertia_in_world(inertia, rotation: Matrix3) -> Matrix3:
    """Inertia A J' A^T [kg m^2] about the center of mass, in world axes."""
    if jnp.ndim(inertia) == 1:
        return rotation @ (inertia[:, None] * rotation.T)
    return rotation @ inertia @ rotation.T


def inertia_times(inertia, rotation: Matrix3, vector: Vector3) -> Vector3:
    """The inertia in world axes times a vector, A (J' (A^T v)): by half of the operations that its matrix takes."""
    own = rotation.T @ vector
    return rotation @ (inertia * own if jnp.ndim(inertia) == 1 else inertia @ own)


def gyroscopic_moment(inertia, rotation: Matrix3, angular_velocity: Vector3) -> Vector3:
    """-w x (J w) [N m] in world axes, for w in world axes [rad/s]; evaluated in body axes (Euler's equations)."""
    own = rotation.T @ angular_velocity
    if jnp.ndim(inertia) > 1:
        return -(rotation @ jnp.cross(own, inertia @ own))
    following, last = jnp.roll(own, -1), jnp.roll(own, -2)
    return rotation @ ((jnp.roll(inertia, -1) - jnp.roll(inertia, -2)) * (following * last))


def inverse_inertia_in_world(inertia, rotation: Matrix3) -> Matrix3:
    """Inverse of the inertia, A J'^(-1) A^T [1 / (kg m^2)], in world axes.

    Of principal moments as B B^T with B = A J'^(-1/2): so a scalar program sees its symmetry, and makes six entries.
    """
    if jnp.ndim(inertia) == 1:
        half = rotation * jnp.sqrt(1 / inertia)
        return half @ half.T
    return rotation @ _inverse(inertia) @ rotation.T


def inverse_inertia(inertia) -> Matrix3:
    """Inverse of the inertia [1 / (kg m^2)], in body axes."""
    return jnp.diag(1 / inertia) if jnp.ndim(inertia) == 1 else _inverse(inertia)


def _inverse(matrix: Matrix3) -> Matrix3:
    """Inverse of a 3 x 3 matrix by cofactors: scalar operations only."""
    a, b, c = matrix
    cofactors = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    return cofactors.T / (a @ cofactors[0])
