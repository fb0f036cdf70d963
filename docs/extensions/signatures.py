"""Signatures as the source writes them: `Number`, `Vector3`, `Float[Array, "n 3"]`, instead of what these stand for."""

import inspect
import re

from sphinx.application import Sphinx

SHORTER = (
    (r"~?(?:jaxlib\._jax|jax)\.Array", "Array"),
    (r"~?jaxtyping\.", ""),
    (r"~?typing\.(?=Any)", ""),
    (r"Float\[Array, ''\] \| float|float \| Float\[Array, ''\]", "Number"),
    (r"Float\[Array, ''\]", "Scalar"),
    (r"Bool\[Array, ''\]", "Flag"),
    (r"Float\[Array, '3'\]", "Vector3"),
    (r"Float\[Array, '3 3'\]", "Matrix3"),
    (r"Float\[Array, '4'\]", "Quaternion"),
)

OF_THE_PROGRAM = {
    "crossing",
    "detects_onsets",
    "effects",
    "has_surfaces",
    "is_touching",
    "medium",
    "memory",
    "memory_at_onset",
    "memory_at_release",
    "requirements",
    "surfaces",
}
"""Members for the compiler of scenes; they are shown once, with the abstract class that asks for them."""


def shorter(
    app: Sphinx,
    what: str,
    name: str,
    thing,
    options,
    signature: str | None,
    returned: str | None,
):
    """Replace what type aliases stand for by the aliases."""
    return tuple(text and _replaced(text) for text in (signature, returned))


def _without_marks(text: str) -> str:
    """`X` for each `Annotated[X, ...]`: units stand in the descriptions."""
    while found := re.search(r"~?(?:typing\.)?Annotated\[", text):
        depth, comma = 1, None
        for at in range(found.end(), len(text)):
            depth += {"[": 1, "(": 1, "]": -1, ")": -1}.get(text[at], 0)
            if depth == 1 and text[at] == "," and comma is None:
                comma = at
            if depth == 0:
                break
        text = text[: found.start()] + text[found.end() : comma] + text[at + 1 :]
    return text


def _replaced(text: str) -> str:
    text = _without_marks(text)
    for pattern, short in SHORTER:
        text = re.sub(pattern, short, text)
    return text


def is_skipped(
    app: Sphinx, what: str, name: str, thing, skip: bool, options
) -> bool | None:
    """Leave out what belongs to the program, but where it is asked for."""
    function = thing.fget if isinstance(thing, property) else thing
    owner = getattr(function, "__qualname__", "").partition(".")[0]
    is_asked_for = owner.startswith("Abstract") or inspect.ismodule(thing)
    return True if name in OF_THE_PROGRAM and not is_asked_for else None


def setup(app: Sphinx) -> dict:
    """Register both."""
    app.connect("autodoc-process-signature", shorter)
    app.connect("autodoc-skip-member", is_skipped)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
