"""What a motion says should be cited."""

import re
from pathlib import Path

import jax.numpy as jnp
import pytest
from public import every_name

import spherejax as sj
from spherejax.output.citations import METHODS, WORKS, named_in, source_of

CLASSES = [
    each
    for each in every_name().values()
    if isinstance(each, type) and each.__module__.startswith("spherejax.") and source_of(each)
]
YEAR = r"\((\d{4})\)"


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_work_that_a_docstring_names_is_known(cls):
    source = source_of(cls).replace(" & ", " and ")
    named = [key for key in named_in(source) for _ in range(source.count(key))]
    assert sorted(re.findall(YEAR, source)) == sorted(re.findall(YEAR, " ".join(named)))


def test_sources_are_found_at_all():
    names = {cls.__name__ for cls in CLASSES}
    assert {"Dry", "Lubricated", "HuntCrossley", "LuGre", "Rodas5P", "FullFilm"} <= names


def test_a_run_is_cited_with_its_laws_and_its_method():
    model = sj.Dry(1e-4, normal=sj.Flores(restitution=0.9), friction=sj.BrownMcPhee())
    run = sj.simulate(sj.gallery.four_bar(model), jnp.array([0.0, 1e-3]))
    said = sj.cite(run)
    lines = said.splitlines()
    assert lines[0].startswith("The spherejax maintainers (2026). spherejax: ")
    assert "doi:10.1007/s11044-022-09843-y" in lines[1]
    assert lines[2].startswith("    for the joint models, Dry, Flores, BrownMcPhee")
    assert "Brown, P. and McPhee, J. (2016). A continuous velocity-based friction model" in said
    assert "(2011). On the continuous contact force models" in said
    assert "Prince, P. J. and Dormand, J. R. (1981). High order" in said
    assert "Lankarani" not in said
    assert "Kidger" in said


def test_a_scene_is_cited_without_a_method():
    said = sj.cite(sj.gallery.four_bar(sj.Lubricated(1e-4, film=sj.laws.FullFilm())))
    assert "Hunt, K. H. and Crossley, F. R. E. (1975)" in said
    assert "Runge-Kutta" not in said


@pytest.mark.parametrize(
    ("solver", "said"),
    [
        (sj.solvers.Rodas5P(), "Rosenbrock-Wanner method Rodas5P"),
        (sj.solvers.Dop853(), "Solving Ordinary Differential Equations I: Nonstiff Problems"),
    ],
    ids=["Rodas5P", "Dop853"],
)
def test_a_method_of_this_package_names_its_source(solver, said):
    run = sj.simulate(sj.gallery.four_bar(sj.Ideal()), jnp.array([0.0, 1e-3]), solver=solver)
    assert said in sj.cite(run)


def test_bibtex_has_one_entry_for_each_work():
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.LuGre()))
    said = sj.cite(scene, bibtex=True)
    keys = re.findall(r"^@\w+\{(\w+),$", said, re.MULTILINE)
    assert len(keys) == len(set(keys)) == len(re.findall(YEAR + r"\. ", sj.cite(scene)))
    assert "canudasdewit1995" in keys
    assert said.count("{") == said.count("}")
    assert "pages = {419--425}" in said


def test_a_class_of_ones_own_says_what_it_comes_from():
    class Own(sj.Threlfall):
        """Mine.

        Source: Hunt & Crossley
        (1975), and the paper.
        """

    assert named_in(source_of(Own)) == ["Hunt and Crossley (1975)", "Rodrigues da Silva et al. (2022)"]
    assert "Hunt, K. H." in sj.cite(sj.gallery.four_bar(sj.Dry(1e-4, friction=Own())))


def test_every_method_of_diffrax_that_is_named_has_a_work():
    assert set(METHODS.values()) <= set(WORKS)


def test_the_software_is_named_as_its_citation_file_has_it():
    file = (Path(__file__).parents[1] / "CITATION.cff").read_text()
    title = re.search(r'^title: "(.*)"$', file, re.MULTILINE)
    assert title
    assert title[1] in sj.cite(sj.gallery.four_bar())


def test_anything_else_is_refused():
    with pytest.raises(sj.SceneError, match="neither a motion nor a scene"):
        sj.cite(3.0)  # pyright: ignore[reportArgumentType]
