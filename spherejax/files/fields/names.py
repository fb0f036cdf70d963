"""Names of bodies and points in files, checked against those that the file describes."""

from dataclasses import dataclass

from spherejax.files.fields.fields import Context, Field, shown
from spherejax.files.fields.quantities import vector
from spherejax.foundations.errors import one_of
from spherejax.physics.bodies import GROUND


@dataclass(frozen=True)
class BodyName(Field):
    """The name of a body, the ground included."""

    @property
    def what(self) -> str:
        """A name."""
        return "a body"

    def read(self, value, place, context):
        """A body that exists."""
        if not isinstance(value, str):
            place.fail(f"{shown(value)} is no body's name")
        if value not in context.points:
            place.fail(f"there is no body {value!r}; {one_of(context.points, value)}")
        return value


@dataclass(frozen=True)
class BodyNames(Field):
    """Names of bodies: two, or any number."""

    n: int | None = 2

    @property
    def what(self) -> str:
        """Two names."""
        return "two bodies" if self.n == 2 else "bodies"

    def read(self, value, place, context):
        """Bodies that exist."""
        if not isinstance(value, list) or (self.n is not None and len(value) != self.n):
            place.fail(f'{shown(value)} is not a list of {self.what}; write ["{GROUND}", "arm"]')
        return tuple(BodyName().read(name, place / i, context) for i, name in enumerate(value))

    def write(self, value, context):
        """A list."""
        return list(value)


@dataclass(frozen=True)
class PointName(Field):
    """`"body.point"`."""

    @property
    def what(self) -> str:
        """How it is written."""
        return '"body.point"'

    def read(self, value, place, context):
        """A point that exists."""
        if not isinstance(value, str) or "." not in value:
            place.fail(f'{shown(value)} is no point; write "body.point", e.g. {self._example(context)}')
        body, _, point = value.partition(".")
        if body not in context.points:
            place.fail(f"{value!r}: there is no body {body!r}; {one_of(context.points, body)}")
        if point not in context.points[body]:
            table = "ground_points" if body == GROUND else f"bodies.{body}.points"
            known = one_of(context.points[body], point)
            place.fail(f"{value!r}: body {body!r} has no point {point!r}; {known}. Add it to [{table}]")
        return value

    @staticmethod
    def _example(context: Context) -> str:
        return next((f'"{b}.{p}"' for b, points in context.points.items() for p in points), '"arm.tip"')


@dataclass(frozen=True)
class End(Field):
    """`"body.point"`, or `"body"` for its center of mass."""

    @property
    def what(self) -> str:
        """How it is written."""
        return '"body.point" or "body"'

    def read(self, value, place, context):
        """A point or a body that exists."""
        is_point = isinstance(value, str) and "." in value
        return (PointName() if is_point else BodyName()).read(value, place, context)


@dataclass(frozen=True)
class Ends(Field):
    """Two ends."""

    @property
    def what(self) -> str:
        """How they are written."""
        return f"two of {End().what}"

    def read(self, value, place, context):
        """Two points or bodies that exist."""
        if not isinstance(value, list) or len(value) != 2:
            place.fail(f'{shown(value)} is not a list of {self.what}; write ["{GROUND}.hook", "arm.tip"]')
        return tuple(End().read(end, place / i, context) for i, end in enumerate(value))

    def write(self, value, context):
        """A list."""
        del context
        return list(value)


@dataclass(frozen=True)
class PointOrPlace(Field):
    """A place in the world at the start, or the name of a point."""

    @property
    def what(self) -> str:
        """Both."""
        return f"{vector('m').what}, or {PointName().what}"

    def unit(self, context):
        """Meters."""
        return vector("m").unit(context)

    def read(self, value, place, context):
        """A place, or a point that exists."""
        return (PointName() if isinstance(value, str) else vector("m")).read(value, place, context)

    def write(self, value, context):
        """The name, or three numbers."""
        return value if isinstance(value, str) else vector("m").write(value, context)
