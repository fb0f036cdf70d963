"""The library's advice in the words of the command line: errors and warnings say `rtol=1e-9`, a command `--rtol 1e-9`.

Texts are written once, for Python, where the cause is known. What a command prints goes through `in_options`, which
knows the options of the command that runs. An argument that is an option becomes the option, with its value as the
command line reads it; an object becomes the word that a table of `catalog.py` has for its class, or the inline table by
which a scene file describes it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping

from spherejax.command_line import catalog
from spherejax.command_line.models import USED_BY
from spherejax.foundations.parts import Parts

OTHER_NAMES = {
    "store": "--out",
    "t_end": "--t1",
    "bounds": "--start",
    "n_samples": "--draws",
    "spreads": "--tolerance",
    "outputs": "--output",
    "observables": "--of",
    "joint": "--of",
    "parameters": "--parameter",
    "inputs": "--input",
}
"""Options that are not called as the argument of the library is."""

WORDS: Mapping[str, tuple[Parts, ...]] = {
    "--solver": (catalog.SOLVERS,),
    "--drift": (catalog.DRIFT_CONTROLS,),
    "--friction": (catalog.FRICTION_LAWS,),
    "--normal": (catalog.NORMAL_LAWS,),
    "--boundary": (catalog.BOUNDARIES,),
    "--film": (catalog.FILMS, catalog.BEARING_FILMS),
    "--elastomer": (catalog.ELASTOMERS,),
}
"""Options whose values are words for classes."""

PHRASES = {
    r"horizon=sj\.studies\.GrowingHorizon\(\)": "without --whole",
    r"method=sj\.studies\.LevenbergMarquardt\(max_iterations=\)": "--max-iterations",
    r"overwrite=True, --overwrite": "--overwrite",
    r"sj\.load_scene\(path, allow_code=True\), or --allow-code on the command line": "--allow-code",
    r"joint=[^;,]*; on the command line --of": "--of",
    r"sj\.simulate\b(?!\()": "spherejax run",
    r"sj\.monte_carlo": "--method samples",
    r"sj\.studies\.sobol_indices": "--method sobol",
    r"models=sj\.joint_models\([^)]*\), on the command line --length": "--length",
}
"""Advice with no argument that is an option, or with both."""

UNDERSCORED = re.compile(r"(?<![\w.\-/'\"])(?P<name>rtol|atol|[a-z]+(?:_[a-z]+)+)(?![\w=(.'\"])")
"""Names of arguments within sentences, as `Raise max_steps`; single words are words of the language but for two."""

_CALL = r"\((?:[^()]|\([^()]*\))*\)"
_VALUE = rf"""(?:
    (?:(?:sj|spherejax|diffrax)\.(?:[a-z]+\.)?)?[A-Za-z]\w+{_CALL}                               # an object
    | {_CALL} | \[[^\]]*\] | \{{[^{{}}]*(?:\{{[^{{}}]*\}}[^{{}}]*)*\}}                    # tuple, list, mapping
    | \.\.\. | '[^']*' | "[^"]*" | [-+]?\d[\w.+-]*\w | \d | True | False | None
)?"""
_ARGUMENT = rf"(?<![\w.\-/?&])(?<!\w\()(?P<name>[a-z_]+[a-z])=(?![=])(?P<value>{_VALUE})"
_OBJECT = rf"\b(?:sj|spherejax|diffrax)\.(?:[a-z]+\.)?(?P<kind>[A-Z]\w+)(?P<arguments>{_CALL})?"
PYTHON = re.compile(f"{_ARGUMENT} | {_OBJECT}", re.VERBOSE)
OBJECT = re.compile(rf"(?:(?:sj|spherejax|diffrax)\.(?:[a-z]+\.)?)?(?P<kind>[A-Z]\w+)(?P<arguments>{_CALL})?")
LOADERS = re.compile(r"(?:sj\.)?load_(?:urdf|mjcf)\(\.\.\., (?P<arguments>(?:[^()]|\([^()]*\))*)\)")


def in_options(text: str, flags: Collection[str]) -> str:
    """A text of the library with options in place of arguments.

    Args:
        text: of an error, a warning, a remedy.
        flags: options of the command that runs.
    """
    if text.startswith("--"):  # texts of the command line itself begin with their option
        return text
    for python, option in PHRASES.items():
        text = re.sub(python, option, text)
    text = LOADERS.sub(lambda call: call["arguments"], text)
    text = PYTHON.sub(lambda found: _replaced(found, flags), text)
    return UNDERSCORED.sub(lambda found: _flag(found["name"], flags) or found[0], text)


def _replaced(found: re.Match[str], flags: Collection[str]) -> str:
    if found["kind"] is not None:
        return _object(found, flags)
    return _option(found["name"], found["value"], flags) or _key(found)


def _flag(name: str, flags: Collection[str]) -> str | None:
    """The option for an argument of the library; None where the command has none."""
    options = (f"--{name.replace('_', '-')}", OTHER_NAMES.get(name))
    return next((option for option in options if option in flags), None)


def _option(name: str, value: str, flags: Collection[str]) -> str | None:
    flag = _flag(name, flags)
    if flag is None or value == "False":
        return None
    if value == "None":
        return f"leaving {flag} out"
    if name in USED_BY and not value.startswith("sj."):
        return None  # a number of a joint that a file describes; the option is of the joint that --of names
    return flag if value in ("", "True") else f"{flag} {_word(flag, value)}"


def _word(flag: str, value: str) -> str:
    """A value as the command line reads it."""
    called = OBJECT.fullmatch(value)
    if called is not None:
        word = _words_of(flag).get(called["kind"], called["kind"])
        numbers = [one for one in (called["arguments"] or "()")[1:-1].split(", ") if "=" in one]
        return f'"{" ".join((word, *numbers))}"' if numbers else word
    if value[0] in "+-.0123456789":
        return value
    try:
        return _joined(ast.literal_eval(value.replace("{..., ", "{")))
    except (SyntaxError, ValueError, TypeError):  # a name that is still to be filled in
        return value.strip("()[]").rstrip(",") if value[0] in "([" else "..."


def _words_of(flag: str) -> dict[str, str]:
    """The words of an option by the classes that they stand for."""
    return {place.rpartition(":")[2]: word for parts in WORDS.get(flag, ()) for word, place in parts.places.items()}


def _joined(value: object) -> str:
    if isinstance(value, Mapping):
        return ",".join(f"{name}={_of_joint(one)}" for name, one in value.items())
    if isinstance(value, tuple | list):
        text = ",".join(map(str, value))
        return f'"{text}"' if " " in text else text
    return _joined((value,)) if isinstance(value, str) else "..."


def _of_joint(value: object) -> str:
    """As `--stops` and `--mimic` read it: a stiffness, and what else there is behind a colon."""
    if value is None:
        return "none"
    numbers = value.values() if isinstance(value, Mapping) else [value]
    return ":".join("K" if number is ... else str(number) for number in numbers)


def _key(found: re.Match[str]) -> str:
    """An argument of a part of the scene, as a key of a scene file."""
    name, value = found["name"], found["value"]
    called = OBJECT.fullmatch(value) if value.endswith(")") else None
    if called is not None:
        value = _table(called)
    elif value in ("True", "False"):
        value = value.lower()
    elif value in ("", "..."):
        return f"{name}{value.replace('...', ' = ...')}"
    return found[0] if value[0] in "({" and called is None else f"{name} = {value}"


def _object(found: re.Match[str], flags: Collection[str]) -> str:
    """An object by itself: an option and its word where there is one, or as a scene file describes it."""
    for flag in WORDS.keys() & set(flags):
        if found["kind"] in _words_of(flag) and flag.removeprefix("--") not in USED_BY:
            return f"{flag} {_words_of(flag)[found['kind']]}"
    return _table(found) if found["arguments"] else found["kind"]


def _table(found: re.Match[str]) -> str:
    arguments = (found["arguments"] or "()")[1:-1]
    rest = f", {arguments.replace('=', ' = ')}" if "=" in arguments else ", ..." if arguments else ""
    return f'{{ kind = "{found["kind"]}"{rest} }}'
