"""Names for arrays, with shapes, used in signatures. All floating-point numbers are 64-bit."""

from typing import Any

from jaxtyping import Array, Bool, Float

Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Matrix3 = Float[Array, "3 3"]
Quaternion = Float[Array, "4"]
Flag = Bool[Array, ""]

Number = float | Scalar
"""A physical number in a constructor: a Python float, or a traced scalar when it is swept or differentiated."""

Numeric = Any
"""An array of physical numbers as the user gave it: nested lists, a NumPy array, a JAX array, or traced."""
