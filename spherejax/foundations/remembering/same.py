"""An object as the key of a table, by identity: for objects that nobody changes, and that take long to compare."""

from typing import Any


class Same:
    """An object that is equal to itself alone. The table that has it as a key holds it, so that no other object gets
    its address.

    Attributes:
        value: the object.
    """

    __slots__ = ("value",)

    def __init__(self, value: Any):
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.value is other.value
