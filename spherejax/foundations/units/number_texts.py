"""Numbers as people type them: one strict form is read, and for every other the error says what was probably meant.

Python's own `float` is not strict: it takes `1_000`, `nan`, `infinity` and the digits of every script. Libraries of
units are laxer still: to them `"1,5 kg"` is 15 kg and `"1.5.2 kg"` 0.3 kg. A text that was typed by hand is where a
mechanism goes wrong in silence, so nothing is guessed here: guesses stand in the error.
"""

import re
from collections.abc import Callable

from spherejax.foundations.errors import SceneError

NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""The one form of a number: digits 0 to 9, a point for decimals, e for powers of ten."""

SMALLEST = 2.2250738585072014e-308
"""The smallest normal number of float64 (2^-1022): below it digits are lost, further below all of them."""

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+-")

_LOOKS_LIKE = {
    **dict.fromkeys(map(ord, "\N{MINUS SIGN}\N{HYPHEN}\N{NON-BREAKING HYPHEN}\N{EN DASH}\N{EM DASH}"), "-"),
    **dict.fromkeys(map(ord, "\N{RIGHT SINGLE QUOTATION MARK}\N{MODIFIER LETTER APOSTROPHE}"), "'"),
    **dict.fromkeys(map(ord, "\N{MULTIPLICATION SIGN}\N{MIDDLE DOT}\N{DOT OPERATOR}"), "*"),
    **dict.fromkeys(map(ord, "\N{ARABIC DECIMAL SEPARATOR}\N{FULLWIDTH COMMA}"), ","),
}
"""Signs of print, one for one, as keyboards have them."""

_HEAD = re.compile(
    r"\s*(?P<sign>[-+]?)\s*(?P<digits>(?:[0-9.,]|(?<=[0-9])[\s'_]+(?=[0-9]))+)"
    r"(?:\s*[x*]\s*10\s*(?:\^|\*\*)?\s*(?P<power>[-+⁻⁺]?[0-9⁰¹²³⁴⁵⁶⁷⁸⁹]+)|\s*[eEdD](?P<exponent>[-+]?[0-9]+))?"
)
"""What looks like a number to a reader: commas, groups of digits, powers of ten written out."""

_POWER_OF_TEN = re.compile(r"(?P<sign>[-+]?)10\s*(?:(?:\^|\*\*)\s*(?P<power>[-+]?[0-9]+)|(?P<raised>[⁻⁺]?[⁰¹²³⁴-⁹]+))")
_GROUPED = re.compile(r"[0-9]{1,3}([\s'_,.])[0-9]{3}(?:\1[0-9]{3})*")


class NumberError(SceneError):
    """A text that is no number."""


def number_in(text: str) -> float:
    """The number that a text is.

    Args:
        text: a number like `"-1.5e-3"`; blanks around it are allowed, inside it nothing is.

    Raises:
        NumberError: for every other text, and for a number that float64 cannot hold; it says what to write.
    """
    found = NUMBER.fullmatch(text.strip())
    if found is None:
        what = suggestion(text, is_right=lambda candidate: bool(NUMBER.fullmatch(candidate)))
        raise NumberError(f"{shortened(text)} is no number; {what}")
    return representable(found.group(), text)


def representable(digits: str, text: str) -> float:
    """The float of a strict number; `text` is what an error shows."""
    value = float(digits)
    if abs(value) == float("inf"):
        raise NumberError(f"{shortened(text)} is larger than any number of 64 bits, 1.8e308; check its exponent")
    if abs(value) < SMALLEST and re.search("[1-9]", re.split("[eE]", digits)[0]):
        raise NumberError(f"{shortened(text)} is smaller than the numbers of 64 bits, 2.2e-308; write 0 or check it")
    return value


def looks_like_number(text: str) -> int:
    """How many characters a reader would take for a number at the beginning of a text; 0 where none is there."""
    found = _HEAD.match(_as_on_a_keyboard(text))
    return found.end() if found is not None else 0


def suggestion(text: str, example: str = "0.1", is_right: Callable[[str], bool] = lambda text: True) -> str:
    """What was probably meant, `write 1.5`, or an example where nothing can be guessed.

    Args:
        text: what was typed: a number, perhaps with something behind it.
        example: a right text.
        is_right: whether a text may be offered.
    """
    candidates = [candidate for candidate in _candidates(text.strip()) if is_right(candidate)]
    quote = "" if NUMBER.fullmatch(example) else '"'
    if candidates:
        return "write " + " or ".join(f"{quote}{candidate}{quote}" for candidate in candidates)
    return f"write it like {quote}{example}{quote}"


def shortened(text: str) -> str:
    """A text for a message, not too long."""
    return repr(text) if len(text) < 60 else f"{text[:40]!r}... ({len(text)} characters)"


def _as_on_a_keyboard(text: str) -> str:
    """The same number of characters: minus signs of print, digits of other scripts as plain ones."""
    plain = text.translate(_LOOKS_LIKE)
    return "".join(str(int(c)) if c.isdecimal() else c for c in plain)


def _candidates(text: str) -> list[str]:
    """Texts with a strict number that were perhaps meant; two where a comma may part thousands or decimals."""
    plain = _as_on_a_keyboard(text)
    found = _POWER_OF_TEN.match(plain)
    if found is not None:
        numbers = [f"{found['sign']}1e{(found['power'] or found['raised']).translate(_SUPERSCRIPTS)}"]
    else:
        found = _HEAD.match(plain)
        numbers = [] if found is None else _readings(found)
    if found is None:
        return []
    # An uncertainty in parentheses, 1.2(3) kg, is left out; what goes on as a number does is not understood.
    rest = re.sub(r"^\([0-9]+\)", "", text[found.end() :]).strip()
    if re.match(r"[\d.,'(*x/^]|[eE](?![^\W\d])", rest):
        return []
    return [f"{number} {rest}".strip() for number in numbers]


def _readings(found: re.Match[str]) -> list[str]:
    """Strict numbers that what looks like one may stand for."""
    power = found["power"] or found["exponent"]
    tail = f"e{power.translate(_SUPERSCRIPTS)}" if power else ""
    sign = found["sign"].replace("+", "")
    return [f"{sign}{one}{tail}" for one in _decimals(found["digits"]) if NUMBER.fullmatch(f"{sign}{one}{tail}")]


def _decimals(digits: str) -> list[str]:
    """Readings of digits with commas, points and gaps."""
    packed = re.sub(r"(?<=[0-9])[\s'](?=[0-9]{3}(?![0-9]))|_", "", digits)
    commas, points = packed.count(","), packed.count(".")
    if not commas and points <= 1:
        return [packed]
    if commas and points:
        decimal, other = (",", ".") if packed.rfind(",") > packed.rfind(".") else (".", ",")
        is_grouped = packed.count(decimal) == 1 and _GROUPED.fullmatch(packed.rpartition(decimal)[0])
        return [packed.replace(other, "").replace(decimal, ".")] if is_grouped else []
    is_grouped = _GROUPED.fullmatch(packed) is not None and not packed.startswith("0")
    joined = [packed.replace(",", "").replace(".", "")] if is_grouped else []
    return joined if commas + points > 1 else [packed.replace(",", "."), *joined]
