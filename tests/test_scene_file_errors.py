"""Bad scene files: every error names file, line, key and remedy; units are converted, and their dimension checked."""

import re
import tomllib
from functools import partial
from pathlib import Path

import my_laws
import numpy as np
import pytest
from double_pendulum import TEXT, write

import spherejax as sj
from spherejax.files.fields.key_lines import key_lines
from spherejax.foundations.units.units import UnitError, in_si


@pytest.fixture
def written(tmp_path):
    """Writes a text to a scene file, with replacements."""
    return partial(write, tmp_path)


@pytest.mark.parametrize(
    ("text", "unit", "number"),
    [
        ("0.1 mm", "m", 1e-4), ("-15 cm", "m", -0.15), ("400 cP", "Pa s", 0.4), ("12 deg", "rad", np.deg2rad(12.0)),
        ("35.9 kN/m", "N/m", 35900.0), ("60 rpm", "rad/s", 2 * np.pi), ("207 GPa", "Pa", 207e9), ("5 %", "1", 0.05),
        ("1e11 N/m^1.5", "N/m^1.5", 1e11), ("1 N*m/deg", "N m/rad", 180 / np.pi), ("+.5 g", "kg", 5e-4),
        ("3 kg/s^2", "N/m", 3.0), ("36 km/h", "m/s", 10.0), ("2 N mm", "N m", 2e-3), ("1 in", None, 0.0254),
        ("1 m/s/s", "m/s^2", 1.0), ("5 1/s", "1/s", 5.0), ("3 /ms", "1/s", 3e3), ("2 kN/(m s)", "N/(m*s)", 2e3),
        ("1.5e-3 kg m\N{SUPERSCRIPT TWO}", "kg m^2", 1.5e-3), ("12\N{DEGREE SIGN}", "rad", np.deg2rad(12.0)),
        ("0.1mm", "m", 1e-4), ("1 m^-1", "1/m", 1.0), ("3", "1", 3.0), ("0 m", "m", 0.0),
    ],
)  # fmt: skip
def test_units_are_converted(text, unit, number):
    assert in_si(text, unit) == pytest.approx(number, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("3 N", "m", "'3 N' is a force [N], but a length [m] is expected"),
        ("3 mm", "N/m", "'3 mm' is a length [m], but a stiffness [N/m] is expected"),
        ("10 Hz", "rad/s", "is a rate [1/s], but an angular velocity [rad/s] is expected"),
        ("1 deg", "1", "is an angle [rad], but a pure number is expected"),
        ("1 N m", "N m/rad", "is a moment [N m], but a rotational stiffness [N m/rad] is expected"),
        ("3", "m", "a number in m is written without quotes"),
        ("5 kg/m^7", "m", "is a number [kg / m ** 7], but a length"),
        ("2 furlongz", "m", "'furlongz' is not defined"),
        ("mm", "m", "begins with no number"),
        ("", "m", "begins with no number"),
        ("2 m + 3", "m", "is no number with a unit"),
        ("20 degC", "m", "is no number with a unit"),
        ("1 m m", "m", "but a length [m] is expected"),
        # Libraries of units read numbers into these: 15 kg, 0 m, 0 N/m, 0.3 kg, 2 kg, 2 m, 6 m, ...
        ("1,5 kg", "kg", 'its number is not a plain one; write "1.5 kg"'),
        ("0,3 m", "m", 'write "0.3 m"'),
        ("1 000 N/m", "N/m", 'write "1000 N/m"'),
        ("1,000 N/m", "N/m", 'write "1.000 N/m" or "1000 N/m"'),
        ("1.000,5 m", "m", 'write "1000.5 m"'),
        ("1.5.2 kg", "kg", "its number is not a plain one; write it like"),
        ("1(2) kg", "kg", 'write "1 kg"'),
        ("1 m 2", "m", "a second number, '2', stands in its unit; is a power meant? m^2"),
        ("2*3 m", "m", "its number is not a plain one"),
        ("1/2 m", "m", "its number is not a plain one"),
        ("1e3e2 m", "m", "its number is not a plain one"),
        ("0x10 m", "m", "its number is not a plain one"),
        ("1_000 m", "m", 'write "1000 m"'),
        ("10^3 N", "N", 'write "1e3 N"'),
        ("2 x 10^-3 N", "N", 'write "2e-3 N"'),
        ("nan m", "m", "begins with no number"),
        ("inf m", "m", "begins with no number"),
        ("1e999 m", "m", "larger than any number of 64 bits"),
        ("1e-400 m", "m", "smaller than the numbers of 64 bits"),
        ("1e300 km^12", "m^12", "beyond the numbers of 64 bits in SI units"),
        ("\N{MINUS SIGN}5 m", "m", 'write "-5 m"'),
        ("\N{FULLWIDTH DIGIT ONE} m", "m", 'write "1 m"'),
        ("\N{ARABIC-INDIC DIGIT ONE} m", "m", 'write "1 m"'),
        ("1 m^400", "m", "to the power '400' is a slip"),
        ("1 m2", None, 'powers are written "m^2"'),
        ("1 s-1", None, "powers are written s^-1"),
        ("1 Nm", "N m", 'write a gap in the product, "N m"'),
        ("400 mPas", "Pa s", 'write a gap in the product, "mPa s"'),
        ("5 Ns/m", None, 'write a gap in the product, "N s"'),
        ("1 W/m K", None, "behind '/' a gap has two readings"),
        ("3 dB", "1", "is no multiple of a unit"),
        ("1 m - 2 m", "m", "a second number"),
        ("1 " + "(" * 5000, "m", "is longer than 100 characters"),
        ("1 " + "m " * 5000, "m", "is longer than 100 characters"),
        ("1 __import__('os')", "m", "is no number with a unit"),
    ],
)
def test_a_wrong_dimension_is_named_with_the_expected_one(text, unit, message):
    with pytest.raises(UnitError, match=re.escape(message)):
        in_si(text, unit)


def test_a_text_is_read_as_it_looks_or_not_at_all():
    """Random texts of what numbers and units are made of: read ones are those that two regular expressions describe."""
    number = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?:\s*(m|mm)|\s+(Em))\s*", re.ASCII)
    scale = {"m": 1.0, "mm": 1e-3, "Em": 1e18}
    random = np.random.default_rng(12)
    pieces = np.array([*"0123456789", *".,-+eE _'()*/^", "m", "mm", " m", " mm", "x", "1e3", "nan", "\N{MINUS SIGN}"])
    n_read = 0
    for _ in range(20_000):
        text = "".join(random.choice(pieces, random.integers(1, 6))) + random.choice(["", "m", " mm", " m"])
        found = number.fullmatch(text)
        if found is None:
            with pytest.raises(UnitError):
                pytest.fail(f"{text!r} is read as {in_si(text, 'm')} m")
        elif 1e-290 < abs(float(found[1])) < 1e290:
            assert in_si(text, "m") == pytest.approx(float(found[1]) * scale[found[2] or found[3]], rel=1e-14)
            n_read += 1
    assert n_read > 1000


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass = 0.8", 'mass = "0.8 m"', "scene.toml:14: bodies.lower.mass: '0.8 m' is a length [m], but a mass [kg]"),
        ("mass = 0.8", "", "scene.toml:13: bodies.lower: Body needs mass, [kg]; add mass = ..."),
        ("mass = 0.8", "mass = true", "scene.toml:14: bodies.lower.mass: True is no number; a mass [kg] is expected"),
        ("mass = 0.8", "mass = -1", "scene.toml:14: bodies.lower.mass: Body: mass = -1 must be positive"),
        ("mass = 0.8", "mas = 0.8", "scene.toml:14: bodies.lower.mas: unknown key of Body; did you mean 'mass'?"),
        ("[0.006, 0.006, 0.0003]", "[1, 2]", ":15: bodies.lower.inertia: 2 numbers; a moment of inertia [kg m^2], 3 n"),
        ("[0.006, 0.006, 0.0003]", "[[1, 2], [3]]", ":15: bodies.lower.inertia: rows of different lengths"),
        ("[0.006, 0.006, 0.0003]", "1.0", ":15: bodies.lower.inertia: a single number; a moment of inertia"),
        ('"40 cm", 0', '"40 cm",\n "0 kg"', ":17: bodies.lower.position[1]: '0 kg' is a mass [kg], but a length [m]"),
        (
            'clearance = "0.1 mm"',
            'clearance = "3 N"',
            ":33: joints.elbow.model.clearance: '3 N' is a force [N], but a l",
        ),
        (
            'clearance = "0.1 mm"',
            "clearance = -1e-4",
            ":33: joints.elbow.model.clearance: Dry: clearance = -0.0001 must",
        ),
        ('clearance = "0.1 mm"', "", ":31: joints.elbow.model: give either clearance= or ball_radius="),
        ("mu = 0.1", "muh = 0.1", "scene.toml:35: joints.elbow.model.friction.muh: unknown key of Threlfall"),
        ("mu = 0.1", "mu = -0.1", "scene.toml:35: joints.elbow.model.friction.mu: Threlfall: mu = -0.1 must"),
        (
            '"threlfall"',
            '"trelfall"',
            ":35: joints.elbow.model.friction.kind: unknown kind 'trelfall' of friction law; did you mean 'threlfall'?",
        ),
        ('"threlfall"', '"hertz"', ":35: joints.elbow.model.friction.kind: 'hertz' is no friction law; there are: amb"),
        ('kind = "dry"', "", "scene.toml:31: joints.elbow.model: has no kind; write kind = "),
        ('kind = "dry"', "kind = 3", "scene.toml:31: joints.elbow.model: has no kind"),
        (
            "restitution = 0.9",
            "restitution = 1.5",
            ":34: joints.elbow.model.normal.restitution: LankaraniNikravesh: res",
        ),
        (
            '"lower.top"',
            '"lower.topp"',
            ":28: joints.elbow.ball: 'lower.topp': body 'lower' has no point 'topp'; did you "
            "mean 'top'? There are: top. Add it to [bodies.lower.points]",
        ),
        (
            '"lower.top"',
            '"lowr.top"',
            ":28: joints.elbow.ball: 'lowr.top': there is no body 'lowr'; did you mean 'lower'?",
        ),
        (
            '"lower.top"',
            '"lower"',
            ':28: joints.elbow.ball: \'lower\' is no point; write "body.point", e.g. "ground.hook"',
        ),
        ('"ground.hook"', '"ground.hok"', "Add it to [ground_points]"),
        ("studied = true", "studied = 1", "scene.toml:29: joints.elbow.studied: 1 is not true or false"),
        ('ball = "upper.top"', 'ball = "upper.top"\nstudied = true', "'shoulder' is the studied joint already"),
        (
            'angle = "90 deg"',
            'angle = "90 m"',
            ":10: bodies.upper.rotation.angle: '90 m' is a length [m], but an angle",
        ),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", ":10: bodies.upper.rotation.axis: must be a direction"),
        ("axis = [0, 1, 0], angle", "angel", "scene.toml:10: bodies.upper.rotation: a rotation is written"),
        (
            'axis = [0, 1, 0], angle = "90 deg"',
            'sequence = "ZZX", angles = [0, 0, 0]',
            "rotation.sequence: 'ZZX' is no seq",
        ),
        ('axis = [0, 1, 0], angle = "90 deg"', 'sequence = "Zx", angles = [0, 0]', "rotation.sequence: 'Zx' is no seq"),
        (
            'axis = [0, 1, 0], angle = "90 deg"',
            'sequence = "ZX", angles = [0]',
            "rotation.angles: 1 angles for the 2 ax",
        ),
        (
            "position = [0.15",
            "quaternion = [1, 0, 0, 0]\nposition = [0.15",
            "rotation and quaternion say the same twice",
        ),
        (
            "hook = [0, 0, 0]",
            "hook = [0, 0]",
            "scene.toml:4: ground_points.hook: 2 numbers; a length [m], 3 numbers, is",
        ),
        (
            "[ground_points]",
            "[ground_point]",
            "scene.toml:3: ground_point: unknown table or key; did you mean 'ground_p",
        ),
        ("[bodies.upper]", "[bodies.ground]", "scene.toml:6: bodies.ground: the name 'ground' is taken by the world"),
        ("[joints.elbow]", "[joints.elbow", "scene.toml: is no TOML: "),
        ('t1 = "40 ms"', 't1 = "40 mm"', "scene.toml:38: simulation.t1: '40 mm' is a length [m], but a time [s]"),
        ('t1 = "40 ms"', "t1 = -1", "scene.toml:38: simulation.t1: -1.0 must be positive"),
        ("samples = 5", "samples = 1", "scene.toml:39: simulation.samples: 1 must be at least 2"),
        ("samples = 5", "samples = 5.5", "scene.toml:39: simulation.samples: 5.5 is not a whole number"),
        ("samples = 5", "dt = 0.1", "scene.toml:39: simulation.dt: 0.1 must not be above t1 = 0.04 [s]"),
        ("samples = 5", "samples = 5\ndt = 0.1", "samples and dt say the same twice"),
        ('solver = "dopri8"', 'solver = "dopri9"', ":41: simulation.solver: 'dopri9' is unknown; did you mean 'dopri"),
        ("rtol = 1e-6", "rtol = 10", "scene.toml:40: simulation.rtol: 10.0 allows errors as large as the motion"),
        ("rtol = 1e-6", "atol = inf", "scene.toml:40: simulation.atol: inf must be positive"),
        (
            "rtol = 1e-6",
            'accuracy = "1 N"',
            "scene.toml:40: simulation.accuracy: '1 N' is a force [N], but a length [m]",
        ),
        ("rtol = 1e-6", "accuracy = -1", "scene.toml:40: simulation.accuracy: 'positions' = -1 must be a positive m"),
        ("rtol = 1e-6", "accuracy = true", 'scene.toml:40: simulation.accuracy: True is no number; write e.g. "1 um"'),
        ("rtol = 1e-6", "accuracy = {}", "scene.toml:40: simulation.accuracy: names no quantity; write"),
        (
            "rtol = 1e-6",
            '[simulation.accuracy]\n"reaction.elbow" = "1 um"',
            "scene.toml:41: simulation.accuracy.reaction.elbow: '1 um' is a length [m], but a force [N] is expected",
        ),
        (
            "rtol = 1e-6",
            "accuracy = { position.lowr = 1e-6 }",
            "scene.toml:40: simulation.accuracy.position.lowr: 'position.lowr': 'position' belongs to a body; write",
        ),
        (
            "rtol = 1e-6",
            'accuracy = { position.lower = 1e-6, "position.lower" = 1e-6 }',
            "scene.toml:40: simulation.accuracy.position.lower: 'position.lower' is named twice",
        ),
        ("samples = 5", "max_steps = -1", "scene.toml:39: simulation.max_steps: -1 must be positive"),
        ("samples = 5", "samples = " + "9" * 400, "scene.toml:39: simulation.samples: 9999"),
        (
            "mass = 0.8",
            "mass = [0.8]",
            "scene.toml:14: bodies.lower.mass: a list of one number; a mass [kg] is expected",
        ),
        (
            "mass = 0.8",
            "mass = 0.8\nvelocity = [1, 0]",
            "scene.toml:15: bodies.lower.velocity: 2 numbers; a velocity [m/s]",
        ),
        ("mass = 0.8", "mass = 0.8\nvelocity = 1", "scene.toml:15: bodies.lower.velocity: a single number; a velocity"),
        ("mass = 0.8", "mass = " + "9" * 400, "scene.toml:14: bodies.lower.mass: 9999"),
        ("mass = 0.8", "mass = " + "9" * 6000, "scene.toml:14: a number of thousands of digits"),
        ("mass = 0.8", "mass = 0x" + "f" * 6000, "scene.toml:14: bodies.lower.mass: a number of more than 4300 digits"),
        ("mass = 0.8", "mass = " + "[" * 400 + "]" * 400, "scene.toml:14: brackets in brackets, more than 50 deep"),
        ("mass = 0.8", "mass = " + "[" * 5000 + "]" * 5000, "scene.toml:14: brackets in brackets, more than 50 deep"),
        ("mass = 0.8", "mass = " + "{a = " * 400 + "1" + "}" * 400, "scene.toml:14: brackets in brackets"),
        ("mass = 0.8", "mass." + ".".join("a" * 5000) + " = 1", "scene.toml:14: bodies.lower.mass: tables in tables"),
        (
            "[ground_points]",
            "gravity = 9.81\n[ground_points]",
            "scene.toml:3: gravity: a single number; an acceleration",
        ),
        (
            'rotation = { axis = [0, 1, 0], angle = "90 deg" }',
            "quaternion = [1, 0, 0]",
            "bodies.upper.quaternion: 3 numbers; a pure number, 4 numbers",
        ),
        ("hook = [0, 0, 0]", 'hook = "z"', "ground_points.hook: 'z' is one text; a length [m], 3 numbers, is expected"),
        ("rtol = 1e-6", "rtoll = 1e-6", "scene.toml:40: simulation.rtoll: unknown key; did you mean 'rtol'?"),
        ('unit = "cm"', 'unit = "kg"', "bodies.lower.points.top.unit: 'kg' is a mass [kg], but a length [m]"),
        (
            'unit = "cm"',
            'unit = "1,5 cm"',
            "points.top.unit: '1,5 cm' is no unit: write a unit alone, without a number",
        ),
        (
            'mass = "1.2 kg"',
            'mass = "1,2 kg"',
            """scene.toml:7: bodies.upper.mass: '1,2 kg' is no number with a unit""",
        ),
        ('unit = "cm"', "units = 1", "a table of numbers is written { values = [1.0, 2.0]"),
        ("title = ", "titel = ", "scene.toml:1: titel: unknown table or key; did you mean 'title'?"),
    ],
)
def test_an_error_names_file_line_key_and_remedy(written, old, new, message):
    with pytest.raises(sj.SceneError) as error:
        sj.load_scene(written(TEXT, (old, new)))
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        ('kind = "my_laws.py:Magnet"\nbody = "upper"', "Magnet needs stiffness"),
        ('kind = "my_laws.py:Magnet"\nbody = "upper"\nstiffness = "1 m"', "'1 m' is a length [m], but a stiffness"),
        ('kind = "my_laws.py:Magnet"\nbody = 3\nstiffness = 1', "3 is not a text"),
        ('kind = "my_laws.py:Magnets"', "my_laws.py has no class 'Magnets'; did you mean 'Magnet'?"),
        ('kind = "my_laws.py:Viscous"', "'my_laws.py:Viscous' is no force; derive a class from AbstractForce"),
        ('kind = "my_lows.py:Magnet"', "there is no file"),
        ('kind = "no_such_module:Magnet"', "no module 'no_such_module' is imported, and a scene file imports none"),
        ('kind = "spherejax.forces:AbstractForce"', "is abstract; it lacks wrenches"),
        ('kind = "applied-wrench"\nbody = "uper"', "there is no body 'uper'; did you mean 'upper'?"),
        ('kind = "applied-wrench"\nbody = ["upper"]', "['upper'] is no body's name"),
        ('kind = "applied-wrench"\nbody = "upper"\nin_body_axes = "yes"', "'yes' is not true or false"),
    ],
)
def test_a_wrong_force_is_named(written, force, message):
    path = written(TEXT + "\n[forces.push]\n" + force)
    (path.parent / "my_laws.py").write_text(Path(my_laws.__file__).read_text())
    with pytest.raises(sj.SceneError, match=r"scene.toml:4[2-9]: forces.push") as error:
        sj.load_scene(path, allow_code=True)
    assert message in str(error.value)


SHOCK = """
[forces.shock]
kind = "spring-damper"
ends = ["ground.hook", "lower"]
spring = { kind = "polynomial", coefficients = [1, "2 N/mm"] }
damper = { kind = "piecewise", breaks = [0], pieces = ["my_laws.py:hat", { kind = "linear", slope = 2.0 }] }
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"2 N/mm"', '"2 N"', "spring.coefficients[1]: '2 N' is a force [N], but a stiffness [N/m] is expected"),
        ("[1, ", '["1 N", 3, ', "'2 N/mm' is a stiffness [N/m], but a number [N/m^2] is expected"),
        (
            '[1, "2 N/mm"]',
            "1",
            "forces.shock.spring.coefficients: 1 is not a list of coefficients, the lowest power first",
        ),
        (
            "breaks = [0]",
            'breaks = ["0 m"]',
            "damper.breaks[0]: '0 m' is a length [m], but a velocity [m/s] is expected",
        ),
        (
            "slope = 2.0",
            'slope = "2 N/m"',
            "pieces[1].slope: '2 N/m' is a stiffness [N/m], but a damping [N s/m] is ex",
        ),
        ('"linear"', '"lineal"', "pieces[1].kind: unknown kind 'lineal' of function; did you mean 'linear'?"),
        (":hat", ":hut", "my_laws.py has no function or class 'hut'; did you mean 'hat'?"),
        ('"my_laws.py:hat"', '{ kind = "my_laws.py:hat", a = 1 }', "pieces[0].a: the function hat has no numbers"),
        ('"my_laws.py:hat"', '"my_laws.py:Viscous"', "pieces[0]: 'my_laws.py:Viscous' is no function"),
        (
            '"my_laws.py:hat"',
            '"hertz"',
            "pieces[0]: 'hertz' is no function; there are: bump, constant, integral, linear",
        ),
        ('["ground.hook", "lower"]', '"lower"', "forces.shock.ends: 'lower' is not a list of two of"),
        ('"lower"]', '"lowr"]', "forces.shock.ends[1]: there is no body 'lowr'; did you mean 'lower'?"),
        ('"lower"]', '"lower.pin"]', "forces.shock.ends[1]: 'lower.pin': body 'lower' has no point 'pin'"),
        ("[0], pieces", "[0, 1], pieces", "damper.breaks: Piecewise: breaks = [0. 1.] must be a list of 1 numbers"),
    ],
)
def test_a_wrong_function_is_named(written, old, new, message):
    path = written(TEXT + SHOCK, (old, new))
    (path.parent / "my_laws.py").write_text(Path(my_laws.__file__).read_text())
    with pytest.raises(sj.SceneError, match=r"scene.toml:4[2-9]: forces.shock") as error:
        sj.load_scene(path, allow_code=True)
    assert message in str(error.value)


def test_what_only_the_whole_scene_shows_names_its_table(written):
    alone = "\n[bodies.alone]\nmass = 1\ninertia = [1, 1, 1]\n"
    with pytest.raises(sj.SceneError, match=r"scene.toml:43: bodies.alone: body 'alone' is joined to nothing"):
        sj.load_scene(written(TEXT + alone))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "scene.toml:1: has no body; write [bodies.NAME]"),
        ("bodies = 3", "scene.toml:1: bodies: has no body"),
        ("[bodies]\na = 3", "scene.toml:2: bodies.a: is no table; write [bodies.a]"),
        ('[bodies."a.b"]\nmass = 1', "has a dot, which parts body and point"),
        ("[bodies.a]\nmass = 1\ninertia = [1, 1, 1]\npoints = 3", "bodies.a.points: 3 is not a table of names"),
        ("title = 3\n[bodies.a]\nmass = 1\ninertia = [1, 1, 1]", "scene.toml:1: title: is no text"),
        ("joints = 3\n[bodies.a]\nmass = 1\ninertia = [1, 1, 1]", "scene.toml:1: joints: is no table"),
        ("simulation = 3\n[bodies.a]\nmass = 1\ninertia = [1, 1, 1]", "scene.toml:1: simulation: is no table"),
        ("drift = []\n[bodies.a]\nmass = 1\ninertia = [1, 1, 1]", "scene.toml:1: drift: [] is no DriftControl"),
        ("drift = 'none'\n[bodies.a]\nmass = 1\ninertia = [1, 1, 1]", "scene.toml:1: drift: unknown kind 'none'"),
        (
            "[bodies.a]\nmass = nan\ninertia = [1, 1, 1]",
            "scene.toml:2: bodies.a.mass: Body: mass = nan must be positive",
        ),
    ],
)
def test_a_file_of_another_form_is_refused(written, text, message):
    with pytest.raises(sj.SceneError) as error:
        sj.load_scene(written(text))
    assert message in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(sj.SceneError, match="No such file"):
        sj.load_scene(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(sj.SceneError, match="UTF-8"):
        sj.load_scene(tmp_path / "bytes.toml")
    with pytest.raises(sj.SceneError, match="cannot read"):
        sj.load_scene(tmp_path)


TRICKY = '''# = [x]
a."b.c".d = 1
s = """x
 y = 3 "" """ # """
[bodies . crank] # = 3
mass = "1 kg # ]"
points = { pivot = [1, 2, {a = 1}], "pin x" = 'a"', z.w = 3 }
[[k.l]]
x = 1
[[k.l]]
x = 2
[k.l.m]
q = 2024-01-01T10:00:00Z
[[k.l.n]]
e = {}
f = [ # hi
 1, [2], # a
 {g = true},
]
"\\u00e4" = 0
'''


def test_every_key_is_found_on_its_line():
    lines = key_lines(TRICKY)
    assert tomllib.loads(TRICKY)
    expected = {
        ("a", "b.c", "d"): 2, ("s",): 3, ("bodies", "crank"): 5, ("bodies", "crank", "mass"): 6,
        ("bodies", "crank", "points", "pivot", 2, "a"): 7, ("bodies", "crank", "points", "pin x"): 7,
        ("bodies", "crank", "points", "z", "w"): 7, ("k", "l", 0, "x"): 9, ("k", "l", 1, "x"): 11,
        ("k", "l", 1, "m", "q"): 13, ("k", "l", 1, "n", 0, "e"): 15, ("k", "l", 1, "n", 0, "f"): 16,
        ("k", "l", 1, "n", 0, "f", 1, 0): 17, ("k", "l", 1, "n", 0, "f", 2, "g"): 18, ("k", "l", 1, "n", 0, "ä"): 20,
    }  # fmt: skip
    assert {path: lines.get(path) for path in expected} == expected
