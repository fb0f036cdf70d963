"""The result of a linearization: matrices, and what follows from them."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Complex, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible
from spherejax.studies.linear.coordinates import Coordinates
from spherejax.studies.linear.modes import Modes
from spherejax.studies.linear.point import OperatingPoint
from spherejax.studies.linear.steadiness import Steadiness
from spherejax.studies.linear.tangent import Geometry

if TYPE_CHECKING:
    import control
    import xarray


class LinearizationWarning(UserWarning):
    """The equations of motion have a kink at the state about which they are linearized."""


@dataclass(frozen=True, repr=False)
class Linearization:
    """x' = A x + B u, y = C x + D u about a state; prints what it is.

    The states are f coordinates x1, x2, ... [sqrt(kg) m] along the free directions P of the mechanism, orthonormal in
    its mass matrix, their speeds u1, u2, ... [sqrt(kg) m/s], and what joints and forces remember. At rest x' = u, and
    the lower left part of A is minus the stiffness over the mass. `basis` says what a state is in the world.

    Attributes:
        A: [1/s], shape (n_x, n_x).
        B: by inputs, shape (n_x, n_u).
        C: of outputs, shape (n_y, n_x).
        D: of outputs by inputs, shape (n_y, n_u).
        inputs: paths of the numbers.
        outputs: names of the quantities.
        output_units: their units; empty where not known.
        states: names.
        basis: P: displacements [m] and rotations [rad] of the bodies in the order of `point.system.bodies`, then their
            velocities and angular velocities, then the memory, by states; world axes, shape (12 n + m, n_x).
        inverse: states by these, shape (n_x, 12 n + m).
        turning: angular velocity of the axes [rad/s].
        steadiness: whether the coefficients are constant.
        point: the state, and the system whose it is.
        coordinates: the independent coordinates, with the masses and P.
        geometry: derivatives of the constraints at the state.
        kept: which of the coordinates, speeds and entries of memory are states; memory that nothing changes is none.
        rates: derivatives of the rates of displacements, velocities and memory along all of these, world axes, shape
            (12 n + m, 2 f + m).
        rounding: how large an entry of A may be by rounding alone.
    """

    A: Float[np.ndarray, "n_x n_x"]
    B: Float[np.ndarray, "n_x n_u"]
    C: Float[np.ndarray, "n_y n_x"]
    D: Float[np.ndarray, "n_y n_u"]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    states: tuple[str, ...]
    basis: Float[np.ndarray, "n_z n_x"]
    inverse: Float[np.ndarray, "n_x n_z"]
    turning: Float[np.ndarray, "3"]
    steadiness: Steadiness
    point: OperatingPoint
    coordinates: Coordinates
    geometry: Geometry
    kept: Bool[np.ndarray, " n"]
    rates: Float[np.ndarray, "n_z n"]
    rounding: Float[np.ndarray, "n_x n_x"]

    @property
    def degrees_of_freedom(self) -> int:
        """f, the number of independent coordinates."""
        return self.coordinates.degrees_of_freedom

    @property
    def is_steady(self) -> bool:
        """Whether the state is one of rest or steady motion, about which the matrices are constant in time."""
        return self.steadiness.is_steady

    @property
    def notes(self) -> list[str]:
        """What a reader of modes must know of the state."""
        if self.is_steady:
            return []
        return [
            "not about a rest or a steady motion: the matrices are those of one moment, and their modes mean something "
            "only where they are fast beside its motion"
        ]

    def modes(self) -> Modes:
        """Eigenvalues, frequencies, damping ratios and shapes."""
        return self._modes

    @cached_property
    def _modes(self) -> Modes:
        return Modes(self)

    def eigenvalue_sensitivity(self, number: str) -> Complex[np.ndarray, " k"]:
        """Derivative of each mode's eigenvalue by a number; see `Modes.eigenvalue_sensitivity`."""
        return self.modes().eigenvalue_sensitivity(number)

    def frequency_response(self, frequencies: Any) -> "xarray.DataArray":
        """C (i w - A)^-1 B + D, complex, over frequency [Hz], output and input.

        Of a small harmonic input u = Re(u0 exp(i w t)) the outputs tend to Re(H u0 exp(i w t)), once what the start has
        excited has died away; where a mode does not die away they never do.

        Args:
            frequencies: [Hz], one or several, not negative.

        Raises:
            SceneError: without inputs or outputs, for frequencies that make no sense, or one at which an undamped mode
                resonates.
        """
        import xarray

        if not self.inputs or not self.outputs:
            raise SceneError(
                "frequency_response goes from inputs to outputs; name some: sj.linearize(scene, inputs="
                '["forces.push.force.z"], outputs=["position.rocker.z"])'
            )
        try:
            f = np.atleast_1d(np.asarray(visible(frequencies), np.float64))
        except (TypeError, ValueError):
            f = np.array([np.nan])
        if f.ndim != 1 or not f.size or not np.all(np.isfinite(f) & (f >= 0)):
            raise SceneError(f"frequency_response: frequencies = {frequencies!r} must be numbers in Hz, none negative")
        unit = np.eye(len(self.A))
        H = np.zeros((f.size, len(self.outputs), len(self.inputs)), complex)
        for k, each in enumerate(f):
            try:
                H[k] = self.C @ np.linalg.solve(2j * np.pi * each * unit - self.A, self.B) + self.D
            except np.linalg.LinAlgError:
                raise SceneError(
                    f"frequency_response: at {each:.9g} Hz an undamped mode resonates, or nothing holds the mechanism "
                    "at 0 Hz; take another frequency"
                ) from None
        return xarray.DataArray(
            H,
            {"frequency": ("frequency", f, {"units": "Hz"}), "output": list(self.outputs), "input": list(self.inputs)},
            ("frequency", "output", "input"),
            "response",
        )

    def to_xarray(self) -> "xarray.Dataset":
        """A, B, C, D and the basis, with names of states, inputs and outputs."""
        import xarray

        data = {
            "A": (("state", "state_"), self.A),
            "B": (("state", "input"), self.B),
            "C": (("output", "state_"), self.C),
            "D": (("output", "input"), self.D),
            "basis": (("change", "state_"), self.basis),
        }
        names = {"state": self.states, "state_": self.states, "input": self.inputs, "output": self.outputs}
        return xarray.Dataset(
            data,
            {name: (name, np.array(list(values), dtype=str)) for name, values in names.items()},
            {"state": self.point.words, "t": self.point.t, "steady": int(self.is_steady)},
        )

    def to_control(self) -> "control.StateSpace":
        """The same as a `StateSpace` of python-control (`pip install 'spherejax[control]'`).

        Raises:
            SceneError: where python-control is not installed, or there are no inputs or outputs.
        """
        try:
            import control
        except ImportError:
            raise SceneError("to_control needs python-control; pip install 'spherejax[control]'") from None
        if not self.inputs or not self.outputs:
            raise SceneError("to_control: a StateSpace needs inputs and outputs; name some to sj.linearize")
        # Dots separate systems from signals there.
        inputs, outputs, states = (
            [name.replace(".", "_") for name in names] for names in (self.inputs, self.outputs, self.states)
        )
        return control.StateSpace(self.A, self.B, self.C, self.D, inputs=inputs, outputs=outputs, states=states)

    def __str__(self) -> str:
        f, m = self.degrees_of_freedom, len(self.states) - 2 * self.degrees_of_freedom
        remembered = f" and {m} that are remembered" if m else ""
        lines = [
            f"Linearization {self.point.words}: {f} degrees of freedom, {len(self.states)} states{remembered}",
            f"inputs: {', '.join(self.inputs) or 'none'}",
            f"outputs: {', '.join(self.outputs) or 'none'}",
        ]
        return "\n".join([*lines, *self.notes])

    __repr__ = __str__
