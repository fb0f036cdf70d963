"""What to cite for a motion: the works that its laws, joints and method say they come from."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx

from spherejax.files.scenes.solvers import SOLVERS
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory


class Work(NamedTuple):
    """One published work.

    Attributes:
        authors: in BibTeX's form, `and` between them.
        title: as published.
        where: journal, book's series, publisher or address.
        volume, pages: where it has them, else empty.
        year: of publication.
        kind: BibTeX's type of entry.
        doi: where it is known for certain.
    """

    authors: str
    title: str
    where: str
    volume: str
    pages: str
    year: int
    kind: str = "article"
    doi: str = ""


_MUBO, _BIT = "Multibody System Dynamics", "BIT Numerical Mathematics"

WORKS: Mapping[str, Work] = {
    "Rodrigues da Silva et al. (2022)": Work(
        "Rodrigues da Silva, M. and Marques, F. and Tavares da Silva, M. and Flores, P.",
        "A comparison of spherical joint models in the dynamic analysis of rigid mechanical systems",
        _MUBO, "56", "221-266", 2022, doi="10.1007/s11044-022-09843-y",
    ),
    "Astrom and Hagglund (2006)": Work(
        "Astrom, K. J. and Hagglund, T.", "Advanced PID Control", "ISA", "", "", 2006, "book",
    ),
    "Astrom and Wittenmark (1997)": Work(
        "Astrom, K. J. and Wittenmark, B.", "Computer-Controlled Systems", "Prentice Hall", "", "", 1997, "book",
    ),
    "Abramowitz and Stegun (1964)": Work(
        "Abramowitz, M. and Stegun, I. A.", "Handbook of Mathematical Functions",
        "National Bureau of Standards", "", "", 1964, "book",
    ),
    "Reynolds (1886)": Work(
        "Reynolds, O.",
        "On the theory of lubrication and its application to Mr. Beauchamp Tower's experiments",
        "Philosophical Transactions of the Royal Society of London", "177", "157-234", 1886,
    ),
    "Vogel (1921)": Work(
        "Vogel, H.", "Das Temperaturabhaengigkeitsgesetz der Viskositaet von Fluessigkeiten",
        "Physikalische Zeitschrift", "22", "645-646", 1921,
    ),
    "Nahme (1940)": Work(
        "Nahme, R.", "Beitraege zur hydrodynamischen Theorie der Lagerreibung",
        "Ingenieur-Archiv", "11", "191-209", 1940,
    ),
    "Barus (1893)": Work(
        "Barus, C.", "Isothermals, isopiestics and isometrics relative to viscosity",
        "American Journal of Science", "45", "87-96", 1893,
    ),
    "Roelands (1966)": Work(
        "Roelands, C. J. A.",
        "Correlational aspects of the viscosity-temperature-pressure relationship of lubricating oils",
        "Technische Hogeschool Delft", "", "", 1966, "phdthesis",
    ),
    "Elrod (1981)": Work(
        "Elrod, H. G.", "A cavitation algorithm",
        "Journal of Lubrication Technology", "103", "350-354", 1981,
    ),
    "Mitsui et al. (1983)": Work(
        "Mitsui, J. and Hori, Y. and Tanaka, M.",
        "Thermohydrodynamic analysis of cooling effect of supply oil in circular journal bearing",
        "Journal of Lubrication Technology", "105", "414-421", 1983,
    ),
    "Higginson (1965)": Work(
        "Higginson, G. R.",
        "The theoretical effects of elastic deformation of the bearing liner on journal bearing performance",
        "Proceedings of the Institution of Mechanical Engineers", "180 (3B)", "31-38", 1965,
    ),
    "Jalali-Vahid et al. (2001)": Work(
        "Jalali-Vahid, D. and Jagatia, M. and Jin, Z. M. and Dowson, D.",
        "Prediction of lubricating film thickness in UHMWPE hip joint replacements",
        "Journal of Biomechanics", "34", "261-266", 2001,
    ),
    "Raimondi and Boyd (1958)": Work(
        "Raimondi, A. A. and Boyd, J.",
        "A solution for the finite journal bearing and its application to analysis and design",
        "ASLE Transactions", "1", "159-209", 1958,
    ),
    "Hertz (1881)": Work(
        "Hertz, H.", "Ueber die Beruehrung fester elastischer Koerper",
        "Journal fuer die reine und angewandte Mathematik", "92", "156-171", 1881,
    ),
    "Hunt and Crossley (1975)": Work(
        "Hunt, K. H. and Crossley, F. R. E.",
        "Coefficient of restitution interpreted as damping in vibroimpact",
        "Journal of Applied Mechanics", "42", "440-445", 1975,
    ),
    "Marhefka and Orin (1999)": Work(
        "Marhefka, D. W. and Orin, D. E.",
        "A compliant contact model with nonlinear damping for simulation of robotic systems",
        "IEEE Transactions on Systems, Man, and Cybernetics A", "29", "566-572", 1999,
    ),
    "Sneddon (1965)": Work(
        "Sneddon, I. N.",
        "The relation between load and penetration in the axisymmetric Boussinesq problem for a punch of arbitrary "
        "profile",
        "International Journal of Engineering Science", "3", "47-57", 1965,
    ),
    "Bartel et al. (1985)": Work(
        "Bartel, D. L. and Burstein, A. H. and Toda, M. D. and Edwards, D. L.",
        "The effect of conformity and plastic thickness on contact stresses in metal-backed plastic implants",
        "Journal of Biomechanical Engineering", "107", "193-199", 1985,
    ),
    "Blankevoort et al. (1991)": Work(
        "Blankevoort, L. and Kuiper, J. H. and Huiskes, R. and Grootenboer, H. J.",
        "Articular contact in a three-dimensional model of the knee",
        "Journal of Biomechanics", "24", "1019-1031", 1991,
    ),
    "Johnson (1985)": Work(
        "Johnson, K. L.", "Contact Mechanics", "Cambridge University Press", "", "", 1985, "book",
    ),
    "ESDU 78035 (1978)": Work(
        "{Engineering Sciences Data Unit}", "Contact phenomena {I}: stresses, deflections and contact dimensions",
        "ESDU", "", "", 1978, "misc",
    ),
    "Pereira, Ramalho and Ambrosio (2011)": Work(
        "Pereira, C. M. and Ramalho, A. L. and Ambrosio, J. A.",
        "A critical overview of internal and external cylinder contact force models",
        "Nonlinear Dynamics", "63", "681-697", 2011,
    ),
    "Ocvirk (1952)": Work(
        "Ocvirk, F. W.", "Short-bearing approximation for full journal bearings",
        "NACA Technical Note 2808", "", "", 1952, "techreport",
    ),
    "Booker (1965)": Work(
        "Booker, J. F.", "Dynamically loaded journal bearings: mobility method of solution",
        "Journal of Basic Engineering", "87", "537-546", 1965,
    ),
    "Sommerfeld (1904)": Work(
        "Sommerfeld, A.", "Zur hydrodynamischen Theorie der Schmiermittelreibung",
        "Zeitschrift fuer Mathematik und Physik", "50", "97-155", 1904,
    ),
    "Lankarani and Nikravesh (1990)": Work(
        "Lankarani, H. M. and Nikravesh, P. E.",
        "A contact force model with hysteresis damping for impact analysis of multibody systems",
        "Journal of Mechanical Design", "112", "369-376", 1990,
    ),
    "Gonthier et al. (2004)": Work(
        "Gonthier, Y. and McPhee, J. and Lange, C. and Piedboeuf, J.-C.",
        "A regularized contact model with asymmetric damping and dwell-time dependent friction",
        _MUBO, "11", "209-233", 2004,
    ),
    "Flores et al. (2011)": Work(
        "Flores, P. and Machado, M. and Silva, M. T. and Martins, J. M.",
        "On the continuous contact force models for soft materials in multibody dynamics",
        _MUBO, "25", "357-375", 2011,
    ),
    "Threlfall (1978)": Work(
        "Threlfall, D. C.",
        "The inclusion of Coulomb friction in mechanisms programs with particular reference to DRAM",
        "Mechanism and Machine Theory", "13", "475-483", 1978,
    ),
    "Bengisu and Akay (1994)": Work(
        "Bengisu, M. T. and Akay, A.",
        "Stability of friction-induced vibrations in multi-degree-of-freedom systems",
        "Journal of Sound and Vibration", "171", "557-570", 1994,
    ),
    "Ambrosio (2003)": Work(
        "Ambrosio, J. A. C.",
        "Impact of rigid and flexible multibody systems: deformation description and contact models",
        "Virtual Nonlinear Multibody Systems, NATO Science Series", "103", "57-81", 2003, "incollection",
    ),
    "Brown and McPhee (2016)": Work(
        "Brown, P. and McPhee, J.",
        "A continuous velocity-based friction model for dynamics and control with physically meaningful parameters",
        "Journal of Computational and Nonlinear Dynamics", "11", "054502", 2016,
    ),
    "Canudas de Wit et al. (1995)": Work(
        "Canudas de Wit, C. and Olsson, H. and Astroem, K. J. and Lischinsky, P.",
        "A new model for control of systems with friction",
        "IEEE Transactions on Automatic Control", "40", "419-425", 1995,
    ),
    "Barabanov and Ortega (2000)": Work(
        "Barabanov, N. and Ortega, R.",
        "Necessary and sufficient conditions for passivity of the LuGre friction model",
        "IEEE Transactions on Automatic Control", "45", "830-832", 2000,
    ),
    "Ambrosio and Verissimo (2009)": Work(
        "Ambrosio, J. and Verissimo, P.",
        "Improved bushing models for general multibody systems and vehicle dynamics",
        _MUBO, "22", "341-365", 2009,
    ),
    "Fritsch and Butland (1984)": Work(
        "Fritsch, F. N. and Butland, J.",
        "A method for constructing local monotone piecewise cubic interpolants",
        "SIAM Journal on Scientific and Statistical Computing", "5", "300-304", 1984,
    ),
    "Fritsch and Carlson (1980)": Work(
        "Fritsch, F. N. and Carlson, R. E.", "Monotone piecewise cubic interpolation",
        "SIAM Journal on Numerical Analysis", "17", "238-246", 1980,
    ),
    "Ferry (1980)": Work(
        "Ferry, J. D.", "Viscoelastic properties of polymers", "Wiley", "", "", 1980, "book",
    ),
    "Berg (1998)": Work(
        "Berg, M.", "A non-linear rubber spring model for rail vehicle dynamics analysis",
        "Vehicle System Dynamics", "30", "197-212", 1998,
    ),
    "Dahl (1976)": Work(
        "Dahl, P. R.", "Solid friction damping of mechanical vibrations", "AIAA Journal", "14", "1675-1682", 1976,
    ),
    "Baumgarte (1972)": Work(
        "Baumgarte, J.", "Stabilization of constraints and integrals of motion in dynamical systems",
        "Computer Methods in Applied Mechanics and Engineering", "1", "1-16", 1972,
    ),
    "Ascher et al. (1994)": Work(
        "Ascher, U. M. and Chin, H. and Reich, S.", "Stabilization of DAEs and invariant manifolds",
        "Numerische Mathematik", "67", "131-149", 1994,
    ),
    "Eich (1993)": Work(
        "Eich, E.",
        "Convergence results for a coordinate projection method applied to mechanical systems with algebraic "
        "constraints",
        "SIAM Journal on Numerical Analysis", "30", "1467-1482", 1993,
    ),
    "Steinebach (1995)": Work(
        "Steinebach, G.", "Order reduction of ROW methods for DAEs and method of lines applications",
        "Preprint, Technische Hochschule Darmstadt", "", "", 1995, "techreport",
    ),
    "Steinebach (2023)": Work(
        "Steinebach, G.",
        "Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia Differential "
        "Equations package",
        _BIT, "63", "27", 2023,
    ),
    "Rang and Angermann (2005)": Work(
        "Rang, J. and Angermann, L.",
        "New Rosenbrock W-methods of order 3 for partial differential algebraic equations of index 1",
        _BIT, "45", "761-787", 2005,
    ),
    "Prince and Dormand (1981)": Work(
        "Prince, P. J. and Dormand, J. R.", "High order embedded Runge-Kutta formulae",
        "Journal of Computational and Applied Mathematics", "7", "67-75", 1981,
    ),
    "Dormand and Prince (1980)": Work(
        "Dormand, J. R. and Prince, P. J.", "A family of embedded Runge-Kutta formulae",
        "Journal of Computational and Applied Mathematics", "6", "19-26", 1980,
    ),
    "Hairer, Norsett and Wanner (1993)": Work(
        "Hairer, E. and Norsett, S. P. and Wanner, G.",
        "Solving Ordinary Differential Equations I: Nonstiff Problems, 2nd edition", "Springer", "", "", 1993, "book",
    ),
    "Tsitouras (2011)": Work(
        "Tsitouras, Ch.",
        "Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption",
        "Computers and Mathematics with Applications", "62", "770-775", 2011,
    ),
    "Kvaerno (2004)": Work(
        "Kvaerno, A.", "Singly diagonally implicit Runge-Kutta methods with an explicit first stage",
        _BIT, "44", "489-502", 2004,
    ),
    "Kidger (2021)": Work(
        "Kidger, P.", "On neural differential equations", "University of Oxford", "", "", 2021, "phdthesis",
    ),
    "Bradbury et al. (2018)": Work(
        "Bradbury, J. and Frostig, R. and Hawkins, P. and Johnson, M. J. and Leary, C. and Maclaurin, D. and others",
        "JAX: composable transformations of Python+NumPy programs",
        "https://github.com/jax-ml/jax", "", "", 2018, "misc",
    ),
}  # fmt: skip
"""By the words with which docstrings name them, `and` between two authors."""

_PLACES = {
    "article": "journal",
    "book": "publisher",
    "incollection": "booktitle",
    "misc": "url",
    "phdthesis": "school",
    "software": "version",
    "techreport": "institution",
}
"""BibTeX's words for where a work of a kind was published."""

THE_PAPER = "Rodrigues da Silva et al. (2022)"

METHODS: Mapping[str, str] = {
    "Dopri5": "Dormand and Prince (1980)",
    "Dopri8": "Prince and Dormand (1981)",
    "Tsit5": "Tsitouras (2011)",
    **dict.fromkeys(("Kvaerno3", "Kvaerno4", "Kvaerno5"), "Kvaerno (2004)"),
}
"""Methods of diffrax."""


def cite(motion: Trajectory | Scene, *, bibtex: bool = False) -> str:
    """What to cite for a motion, or a scene: each work, and what it is cited for.

    A law, a joint or a method names its source in its docstring; so does a class of your own, with a line
    `Source: Hunt and Crossley (1975)` of works that are known here. What was derived in spherejax is cited by it alone.

    Args:
        motion: the motion, with the method that was used, or the scene.
        bibtex: as BibTeX entries instead of text.

    Raises:
        SceneError: for anything else.
    """
    if not isinstance(motion, Trajectory | Scene):
        raise SceneError(
            f"cite: {type(motion).__name__} is neither a motion nor a scene; give what sj.simulate returns"
        )
    cited: dict[str, list[str]] = {THE_PAPER: ["the joint models"]}
    for cls in dict.fromkeys(_parts(motion.system if isinstance(motion, Trajectory) else motion)):
        for key in named_in(source_of(cls)):
            cited.setdefault(key, []).append(cls.__name__)
    if isinstance(motion, Trajectory):
        # "Dopri8 or Ros34PW2" where the run chose when it started
        for method in motion.choice.partition(":")[0].strip().split(" or "):
            for key in _works_of_method(method):
                cited.setdefault(key, []).append(method)
    cited["Kidger (2021)"] = ["diffrax, which integrates"]
    cited["Bradbury et al. (2018)"] = ["JAX"]
    found = [(_own(version("spherejax")), []), *((WORKS[key], uses) for key, uses in cited.items())]
    return "\n".join((_entry if bibtex else _line)(work, uses) for work, uses in found)


def _own(release: str) -> Work:
    """spherejax itself, as `CITATION.cff` has it."""
    title = "spherejax: differentiable multibody simulation with ideal, dry, lubricated and bushing spherical joints"
    return Work("{The spherejax maintainers}", title, release, "", "", 2026, "software")


def _works_of_method(name: str) -> list[str]:
    if name in METHODS:
        return [METHODS[name]]
    own = [SOLVERS[word] for word, place in SOLVERS.places.items() if place.endswith(f":{name}")]
    return [key for solver in own for key in named_in(source_of(solver))]


def source_of(cls: type) -> str:
    """What the docstring of a class says behind `Source:`, on one line; empty where it says nothing."""
    found = re.search(r"Source: (.*?)(?:\n\s*\n|\Z)", cls.__dict__.get("__doc__") or "", re.DOTALL)
    return " ".join(found[1].split()) if found else ""


def named_in(source: str) -> list[str]:
    """The keys of `WORKS` that a source names."""
    said = re.sub(r"\bthe paper\b", THE_PAPER, source.replace(" & ", " and "))
    return sorted((key for key in WORKS if key in said), key=said.index)


def _parts(value: Any) -> Iterator[type]:
    """The classes of which a scene is made, from the outside in."""
    if isinstance(value, eqx.Module) or (is_dataclass(value) and not isinstance(value, type)):
        yield type(value)
        for field in fields(value):  # pyright: ignore[reportArgumentType]
            yield from _parts(getattr(value, field.name, None))
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _parts(each)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _parts(each)


def _line(work: Work, uses: list[str]) -> str:
    names = work.authors.replace(" and others", " et al.").split(" and ")
    several = len(names) > 1 and not names[-1].endswith("et al.")
    authors = f"{', '.join(names[:-1])} and {names[-1]}" if several else ", ".join(names)
    where = f"Version {work.where}" if work.kind == "software" else work.where
    place = f"{where} {work.volume}".strip() + (f":{work.pages}" if work.pages else "")
    doi = f". doi:{work.doi}" if work.doi else ""
    used = f"\n    for {', '.join(uses)}" if uses else ""
    return f"{authors.strip('{}')} ({work.year}). {work.title}. {place}{doi}{used}"


def _entry(work: Work, uses: list[str]) -> str:
    said = {
        "author": work.authors,
        "title": f"{{{work.title}}}",
        _PLACES[work.kind]: work.where,
        "volume": work.volume,
        "pages": work.pages.replace("-", "--"),
        "year": str(work.year),
        "doi": work.doi,
        "note": f"for {', '.join(uses)}" if uses else "",
    }
    name = re.sub(r"\W", "", work.authors.partition(",")[0]).lower().removeprefix("the") + str(work.year)
    rows = "".join(f"  {key} = {{{value}}},\n" for key, value in said.items() if value)
    return f"@{work.kind}{{{name},\n{rows}}}"
