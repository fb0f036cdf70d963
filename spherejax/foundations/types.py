"""Names for arrays, with shapes, used in signatures. All floating-point numbers are 64-bit."""

from typing import Annotated, Any, NamedTuple

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


class Shaped(NamedTuple):
    """A mark on an annotation: the value is numbers of one of these shapes, in whatever the user gave them."""

    shapes: tuple[tuple[int, ...], ...]


Single = Annotated[Numeric, Shaped(((),))]
"""One physical number, as the user gave it."""

Triple = Annotated[Numeric, Shaped(((3,),))]
"""Three physical numbers, as the user gave them: a vector, a place."""

Quadruple = Annotated[Numeric, Shaped(((4,),))]
"""Four numbers, as the user gave them: a quaternion."""

Moments = Annotated[Numeric, Shaped(((3,), (3, 3)))]
"""Three principal moments, or a matrix, as the user gave them."""
