"""What a function of one variable is: a pytree of numbers that is called with a number.

The numbers in a function are leaves: a table's ordinates can be swept and fitted like a mass. A function is written for
one number; `jax.vmap(f)(xs)` evaluates it at many.
"""

import abc
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number, Numeric, Scalar
from spherejax.physics.functions.closures import (
    ConstantArray,
    Placeholder,
    Template,
    as_float,
    closure_converted,
    is_number,
    is_tracer,
    restored,
)
from spherejax.physics.renamed import by_new_name, take_old_name


class AbstractFunction(eqx.Module):
    """A function y = f(x) of one number; units are those of the place where it is used.

    A function of your own is a plain Python function of one number in `jnp`, wherever a function is asked for; or, to
    have numbers in it that can be swept and fitted, a subclass of this with `__call__`.
    """

    @abc.abstractmethod
    def __call__(self, x: Number) -> Scalar:
        """f(x)."""

    @property
    def knows_primitive(self) -> bool:
        """Whether `primitive` is given (static); a spring with such a law has a potential energy."""
        return False

    def primitive(self, x: Number) -> Scalar:
        """F(x) with dF/dx = f, up to a constant."""
        raise TypeError(f"{type(self).__name__} does not know its primitive")

    def derivative(self, x: Number) -> Scalar:
        """df/dx; at a kink that of one side."""
        return _derivative(self, x)

    def second_derivative(self, x: Number) -> Scalar:
        """d2f/dx2; zero at a kink."""
        return _derivative(lambda x: _derivative(self, x), x)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar | None:
        """How far from x something begins, ends or turns [unit of x], ahead or, with `is_forward` False, behind.

        A step of the integration goes no further, so that no bump in a road and no jump of a drive is passed over.
        None, unless a function says otherwise: then a hundredth of the whole motion bounds the steps, and forces are
        looked at between the stages of a step; what is shorter than 1/20,000 of the motion can be missed.
        """
        del x, is_forward
        return None

    def room(self, x: Number, is_forward: Number) -> Scalar | None:
        """The earlier name of `distance_to_breakpoint`; a class that overrides it is served, with a warning."""
        return by_new_name(self, "room", "distance_to_breakpoint")(x, is_forward)

    def __init_subclass__(cls, **settings):
        super().__init_subclass__(**settings)
        take_old_name(cls, "room", "distance_to_breakpoint")

    @property
    def is_unknown(self) -> bool:
        """Whether nothing is known of where the function turns (static), so that steps must look for it.

        Of a plain function nothing is, nor of a class of the user's own that does not say it by
        `distance_to_breakpoint`.
        """
        is_own = not type(self).__module__.startswith("spherejax.")
        return is_own and type(self).distance_to_breakpoint is AbstractFunction.distance_to_breakpoint

    @property
    def may_jump(self) -> bool:
        """Whether its value may jump, or its slope at a place that `distance_to_breakpoint` does not tell (static).

        A driver that prescribes such a function is looked at before a run: a prescribed motion must not jump.
        """
        return True

    @property
    def domain(self) -> tuple[Number, Number] | None:
        """Between which places the function is known [unit of x]; None for everywhere."""
        return None

    def requirements(self) -> list[Requirement]:
        """What the function's numbers must satisfy."""
        return []


def distance_to_next(marks: Sequence[Number] | Numeric, x: Number, is_forward: Number) -> Scalar:
    """The distance from x to the nearest of the marks ahead, or behind; infinite behind the last one.

    A mark as near as rounding is passed: a step that ends on it does not stay there.
    """
    places = jnp.stack([jnp.asarray(mark, jnp.float64) for mark in marks])
    ahead = jnp.where(is_forward, places - x, x - places)
    return jnp.min(jnp.where(ahead > 1e-12 * (jnp.abs(x) + jnp.abs(places)), ahead, jnp.inf))


def nearest_breakpoint(distances: Iterable[Scalar | None]) -> Scalar | None:
    """The least of several; None where none is known."""
    known = [jnp.asarray(distance, jnp.float64) for distance in distances if distance is not None]
    return jnp.min(jnp.stack(known)) if known else None


def _derivative(function: Callable, x: Number) -> Scalar:
    x = jnp.asarray(x, jnp.float64)
    return jax.jvp(function, (x,), (jnp.ones_like(x),))[1]


class Network(eqx.Module):
    """A module whose arrays are numbers of the scene, and whose functions are structure: e.g. an `equinox.nn.MLP`.

    A network holds its activation among its arrays; a scene asks that its leaves are numbers. Called, it is the
    module:

        law = sj.Network(eqx.nn.MLP(2, "scalar", 8, 2, activation=jnp.tanh, key=key))
        sj.SpringDamper(ends, law=law)    # law(length, rate, t) has three arguments: MLP(3, ...) of jnp.stack([...])

    Attributes:
        numbers: its arrays of a floating type; as float64, those of complex numbers, real and imaginary parts, and
            traced arrays of another type.
        structure: all else of it (static).

    Limits: activations of `jax.nn` keep the scalar program, those with derivative rules of their own (`relu`) as well.
    Arrays of whole numbers, truths and random keys are structure, and are compared by value: two modules with other
    indices are two programs. Where JAX traces such an array (`equinox.filter_jit`), it is among the numbers, without
    derivatives, and one program serves all of its values.
    """

    numbers: tuple[Any, ...]
    structure: Any = eqx.field(static=True)

    def __init__(self, module: Any):
        leaves, tree = jax.tree.flatten(module)
        numbers: list = []
        parts = tuple(self._part(leaf, numbers) for leaf in leaves)
        self.numbers, self.structure = tuple(numbers), (tree, parts)

    @staticmethod
    def _part(leaf: Any, numbers: list) -> Any:
        """What stands for a leaf in the structure; if it is among the numbers, it is appended to these."""
        is_complex = is_number(leaf) and jnp.iscomplexobj(leaf)
        if is_complex or (is_tracer(leaf) and not is_number(leaf)):
            numbers.append(as_float(leaf))
            return Placeholder(len(numbers) - 1, jnp.result_type(leaf))
        if is_number(leaf):
            numbers.append(leaf)
            return Placeholder(len(numbers) - 1, None)
        return ConstantArray(leaf) if isinstance(leaf, np.ndarray | jax.Array) else leaf

    @property
    def module(self) -> Any:
        """The module, with the numbers of now."""
        tree, parts = self.structure

        def leaf(part: Any) -> Any:
            if isinstance(part, ConstantArray):
                return part.array
            if not isinstance(part, Placeholder):
                return part
            return self.numbers[part.index] if part.dtype is None else restored(part, self.numbers)

        return jax.tree.unflatten(tree, map(leaf, parts))

    def __call__(self, *arguments) -> Any:
        """The module's value."""
        return self.module(*arguments)


class Given(eqx.Module):
    """A callable that a user gave, as a pytree.

    Attributes:
        module: the callable, where it is an `equinox.Module`: its numbers are leaves.
        function: the callable, where it is a plain function: it is structure, and two scenes with different functions
            are different programs. Define it once, outside of what is called repeatedly.
        captured: traced values that a callable closes over (a parameter of a sweep, of a fit, of a derivative): they
            are leaves, too; empty without.
        template: the callable without these values; None without.
    """

    module: Any
    function: Callable | None = eqx.field(static=True)
    captured: tuple[Any, ...]
    template: Template | None = eqx.field(static=True)

    def __init__(self, given: Callable):
        self.module, self.function, self.captured, self.template = None, None, (), None
        converted = closure_converted(given)
        if converted is not None:
            self.template, self.captured = converted
        elif not isinstance(given, eqx.Module):
            self.function = given
        else:
            # A network holds functions among its numbers.
            holds_functions = any(callable(leaf) for leaf in jax.tree.leaves(given))
            self.module = Network(given) if holds_functions else given

    @property
    def callable(self) -> Callable:
        """What was given."""
        if self.template is not None:
            return self.template.filled(self.captured)
        return self.module if self.function is None else self.function

    def __call__(self, *arguments):
        """The callable's value."""
        return self.callable(*arguments)


class UserFunction(AbstractFunction):
    """A user's callable f(x).

    Attributes:
        given: the callable.
    """

    given: Given

    def __init__(self, function: Callable):
        self.given = Given(function)

    @property
    def is_unknown(self) -> bool:
        """True."""
        return True

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        return jnp.asarray(self.given(x))


class ConvertedFunction(AbstractFunction):
    """A function of a user's own class whose static parts close over traced values.

    Attributes:
        given: the function, with these values and its own numbers as leaves.
    """

    given: Given

    @property
    def function(self) -> AbstractFunction:
        """The function, with the numbers of now."""
        function = self.given.callable
        assert isinstance(function, AbstractFunction)
        return function

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        return self.function(x)

    @property
    def knows_primitive(self) -> bool:
        """Whether the function does."""
        return self.function.knows_primitive

    def primitive(self, x: Number) -> Scalar:
        """That of the function."""
        return self.function.primitive(x)

    def derivative(self, x: Number) -> Scalar:
        """That of the function."""
        return self.function.derivative(x)

    def second_derivative(self, x: Number) -> Scalar:
        """That of the function."""
        return self.function.second_derivative(x)

    @property
    def is_unknown(self) -> bool:
        """As the function."""
        return self.function.is_unknown

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar | None:
        """That of the function."""
        return self.function.distance_to_breakpoint(x, is_forward)

    def requirements(self) -> list[Requirement]:
        """Those of the function."""
        return self.function.requirements()


def as_function(value) -> AbstractFunction | None:
    """A function as given, a callable as `UserFunction`; None stays None.

    Raises:
        SceneError: for what cannot be called.
    """
    if value is None:
        return None
    if isinstance(value, AbstractFunction):
        is_own = type(value).__module__.partition(".")[0] == __name__.partition(".")[0]
        given = None if is_own else Given(value)
        return value if given is None or given.template is None else ConvertedFunction(given)
    if inspect.isclass(value) and issubclass(value, AbstractFunction):
        raise SceneError(f"{value.__name__} alone is no function; give its numbers, {value.__name__}(...)")
    if not callable(value):
        raise SceneError(f"{value!r} is no function; give e.g. Linear(slope), Table(x, y) or a function of one number")
    return UserFunction(value)


def function_requirements(field: str, function: AbstractFunction | None) -> list[Requirement]:
    """The requirements of a function that is the field of something else."""
    rows = [] if function is None else function.requirements()
    return [row._replace(field=f"{field}.{row.field}") for row in rows]
