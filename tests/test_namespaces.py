"""Namespaces: what is in them, and that names which left the top say where they are now."""

import inspect
import pickle
import subprocess
import sys
import warnings

import pytest
from public import NAMESPACES, every_name

import spherejax as sj
from spherejax.namespaces import MOVED

AT_THE_TOP = 105
"""Names, modules among them, that a newcomer can be shown; there were 256."""

NEEDED = [
    "simulate", "sweep", "fit", "work_precision", "effects", "gallery",
    "runtime", "Ideal", "Dry", "Lubricated", "Bushing", "Hertz",
    "HuntCrossley", "LankaraniNikravesh", "Gonthier", "Flores", "ExactRestitution", "Threlfall",
    "BengisuAkay", "Ambrosio", "BrownMcPhee", "LuGre", "Guembel", "PinkusSternlicht",
    "Sommerfeld",
]  # fmt: skip
"""What describes, simulates and looks at a joint, which stays at the top."""


def test_the_top_holds_what_is_needed_first():
    assert set(NEEDED) <= set(sj.__all__) == set(dir(sj))
    assert len(sj.__all__) <= AT_THE_TOP
    assert not set(sj.__all__) & set(MOVED)


def test_generic_names_have_moved():
    assert {"Line", "Step", "Sum", "Whole", "Block", "Grid", "Design"} <= set(MOVED)


@pytest.mark.parametrize("name", MOVED)
def test_an_old_name_gives_the_same_thing_and_says_the_new_one(name):
    new = f"sj.{MOVED[name]}.{name}"
    with pytest.warns(DeprecationWarning, match=f"^sj.{name} is called {new}$") as told:
        old = getattr(sj, name)
    assert told[0].filename == __file__
    assert old is getattr(NAMESPACES[MOVED[name]], name)


def test_every_name_is_where_it_is_said_to_be():
    assert set(MOVED.values()) == set(NAMESPACES)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = every_name()
    assert set(MOVED) <= set(found)
    assert not [name for name, thing in found.items() if thing is None]


@pytest.mark.parametrize("name", NAMESPACES)
def test_a_namespace_says_what_is_in_it(name):
    space = NAMESPACES[name]
    assert inspect.ismodule(space)
    assert len(space.__doc__ or "") > 60
    assert set(dir(space)) >= set(space.__all__)
    assert not set(space.__all__) - set(every_name()) - {"hooks", "linear_algebra", "native_code", "runge_kutta"}
    with pytest.raises(AttributeError, match="no_such_name"):
        space.no_such_name  # noqa: B018


def test_names_of_both_places_are_one():
    shared = [(name, space) for space in NAMESPACES.values() for name in space.__all__ if name in sj.__all__]
    assert len(shared) > 40
    assert all(getattr(sj, name) is getattr(space, name) for name, space in shared)


def test_imports_work_as_of_any_module():
    code = (
        "import sys\nfrom spherejax.laws import Maxwell, Hertz\nimport spherejax.solvers as s\nimport spherejax as sj\n"
        "assert sj.laws.Maxwell is Maxwell and sj.Hertz is Hertz and s.Rodas5P is sj.solvers.Rodas5P\n"
        "from spherejax.laws import *\nassert BrownMcPhee is sj.BrownMcPhee\nassert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", code], check=True, timeout=120)


def test_an_old_import_warns_and_works():
    code = "import warnings\nwarnings.simplefilter('error')\nfrom spherejax import Maxwell"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert "DeprecationWarning: sj.Maxwell is called sj.laws.Maxwell" in done.stderr


def test_what_was_pickled_by_its_module_is_read_again():
    law = sj.laws.Maxwell(1e5, 1e-2)
    assert b"spherejax.physics.laws.viscoelastic" in pickle.dumps(law)
    assert pickle.loads(pickle.dumps(law)).stiffness == law.stiffness
