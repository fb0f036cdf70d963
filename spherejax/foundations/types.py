"""Names for arrays, with shapes, used in signatures. All floating-point numbers are 64-bit."""

from enum import Enum
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

Listed = Annotated[Numeric, Shaped(((-1,),))]
"""Numbers in a row, any number of them, as the user gave them."""


class Unit(NamedTuple):
    """A mark on an annotation: the SI unit of a number, a vector or a table of them.

    Attributes:
        si: e.g. `"N s/m"`; `"1"` for pure numbers. In braces: a number of the same object, `"N/m^{exponent}"`, or what
            the place says where a function stands, `{of_argument}` and `{of_value}`; or what the class's `unit_words`
            says by the object's parts, such as the unit of a coordinate, which is a length or an angle.
        shown: for lists and docstrings, where the parts decide: `"N/m or N m/rad"`.
    """

    si: str
    shown: str = ""


class Function(NamedTuple):
    """A mark on an annotation: a function of one number, with the SI units of its argument and its value.

    Attributes:
        argument: as in `Unit`.
        value: as in `Unit`.
        shown: of the value, as in `Unit`.
    """

    argument: str
    value: str
    shown: str = ""


class Named(Enum):
    """Marks on annotations: names of bodies and points."""

    BODY = "a body"
    BODIES = "two bodies"
    POINT = '"body.point"'
    END = '"body.point" or "body"'
    ENDS = "two ends"
    PLACE = "a point, or three numbers in world axes at the start"


class Mark(Enum):
    """Further marks on annotations."""

    OWN = "a function that only a user can write: of several arguments, or with several values"
    COEFFICIENTS = "of a polynomial, the lowest power first"


OWN, COEFFICIENTS = Mark.OWN, Mark.COEFFICIENTS
