"""An FMU in C: the scalar programs of a scene with `instance.c` around them, compiled here and shipped with its source.

It needs neither Python nor this package where it runs.
"""

import hashlib
import os
import platform
import re
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import numpy as np

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import System, flatten_system
from spherejax.motion.integration.audit import CONSTRAINT_SHARE, NORM, OUTSIDE, Vitals, limits_of
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.solvers.traits import is_explicit, n_stages_of_end
from spherejax.motion.start.assembly import CLOSING_TOLERANCE, N_NEWTON_STEPS, as_ideal
from spherejax.motion.start.positions import FAR_TURNED, far_distance
from spherejax.motion.start.tolerances import ABSOLUTE_SHARE, component_tolerances, length_scale
from spherejax.motion.start.velocities import NOTICEABLE
from spherejax.output.fmu.description import DefaultExperiment, Kinds, description
from spherejax.output.fmu.ports import Port, Ports
from spherejax.output.fmu.programs import Written, n_crossings, written
from spherejax.output.search_path import program_on_path

OPTIONS = (
    "-std=c11", "-O2", "-ffp-contract=off", "-shared", "-fvisibility=hidden", "-Wall", "-Wno-unused-function"
)  # fmt: skip
"""No -ffast-math, and no fused multiply-add: the order and the roundings of the arithmetic are those of the scalar
program. GCC fuses by default wherever the processor can: on aarch64 always, on x86-64 with -march=native."""

LANDING_WINDOW = 1e-9
"""Steps end within this of a contact's surface, in its crossing function, as in `motion/solvers/landing.py`."""

HYSTERESIS = 1e-7
"""Of event indicators, in the crossing function, whose scale is the clearance: a tenth of what the audit allows. Root
finders of importers are a few hundred roundings of time off: at an impact of 1 m/s in a clearance of 0.1 mm (10,000/s)
4e-10 for t = 2 s."""

MAX_STEPS = 5_000_000
"""Of one communication step."""

STEPS_AT_LEAST = 100
"""Steps over the experiment, at least, where something depends on time; as in `motion/integration/longest_step.py`."""


def write_native(
    scene: Scene,
    path: Path,
    identifier: str,
    words: str,
    ports: Ports,
    choice: SolverChoice,
    experiment: DefaultExperiment,
) -> None:
    """Write the FMU.

    Raises:
        SceneError: where there is no C compiler, or the scene cannot be written in C.
    """
    compiler = compiler_of()
    target = target_of(compiler)  # before the programs are traced: it may be refused
    programs = written(scene, ports)
    explicit = choice.solver if is_explicit(choice.solver) else None
    indicators = _indicators(programs.system)
    body = model_source(programs, ports, explicit, experiment)
    instance = resources.files("spherejax.output.fmu").joinpath("instance.c").read_text(encoding="utf-8")
    token = str(uuid.UUID(hashlib.sha256((identifier + body + instance).encode()).hexdigest()[:32]))
    source = f'#define TOKEN "{token}"\n{body}#include "instance.c"\n'
    states = state_ports(programs.system)
    kinds = Kinds(True, explicit is not None)
    xml = description(identifier, token, words, kinds, experiment, ports, states, indicators)
    with tempfile.TemporaryDirectory(prefix="spherejax_fmu_") as folder:
        library = _compiled(compiler, target, Path(folder), source, instance)
        with draft_of(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("modelDescription.xml", xml)
            file.writestr("sources/model.c", source)
            file.writestr("sources/instance.c", instance)
            file.writestr("sources/buildDescription.xml", _build_description(identifier))
            file.write(library, f"binaries/{target.platform}/{identifier}{target.suffix}")


def compiler_of() -> str:
    """The C compiler: that of the variable CC, or cc, gcc or clang. A cross compiler makes an FMU for its own system.

    Raises:
        SceneError: where there is none.
    """
    names = [os.environ["CC"]] if os.environ.get("CC") else ["cc", "gcc", "clang"]
    found = next(filter(None, map(program_on_path, names)), None)
    if found is None:
        raise SceneError(
            f"export_fmu: no C compiler ({', '.join(names)}) is on the PATH; install one (Debian: apt install gcc; "
            "macOS: xcode-select --install; Windows: MinGW-w64 or LLVM, not Microsoft's cl), or export with "
            'kind="python"'
        )
    return found


def model_source(programs: Written, ports: Ports, explicit: Any, experiment: DefaultExperiment) -> str:
    """What is specific to a scene, in C; with the method of the steps of co-simulation, if there is one."""
    system = programs.system
    layout = system.layout
    tolerances = component_tolerances(system, experiment.rtol)
    relative, absolute = (np.broadcast_to(np.asarray(x), (layout.size,)) for x in (tolerances.rtol, tolerances.atol))
    limits = limits_of(system, experiment.rtol, diffrax.Dopri8())
    method = diffrax.Dopri8() if explicit is None else explicit
    ideal = flatten_system(as_ideal(system))
    tableau: Any = method.tableau
    # Of two estimates of the error the one of the higher order is taken alone: it is never less than both together.
    n_stages = n_stages_of_end(tableau)
    sizes = {
        "N_VALUES": len(ports.values),
        "N_INPUTS": len(ports.inputs),
        "N_STATES": layout.size,
        "N_CONTINUOUS": layout.work_start,
        "N_BODIES": layout.n_bodies,
        "IS_DRIVEN": int(system.is_driven),
        "N_START": layout.memory_start,
        "N_MEMORY": layout.n_memory,
        "N_OUTPUTS": len(ports.outputs),
        "N_CONTACTS": len(system.contact_joints),
        "N_CROSSINGS": n_crossings(programs.programs["crossing"]),
        "N_CORRECTIONS": system.drift.n_corrections,
        "HAS_ROOM": int(programs.has_room),
        "READS_TIME": int(programs.reads_time),
        "TRACKS_CONSTRAINT_WORK": int(system.tracks_constraint_work),
        "HAS_CO_SIMULATION": int(explicit is not None),
        "N_STAGES": n_stages,
        "N_NEWTON_STEPS": N_NEWTON_STEPS,
        "MAX_STEPS": MAX_STEPS,
    }
    levels = {
        "ORDER": int(method.order(_TERM)),
        "CLOSING_TOLERANCE": CLOSING_TOLERANCE,
        "LANDING_WINDOW": LANDING_WINDOW,
        "HYSTERESIS": HYSTERESIS,
        "LONGEST_STEP": experiment.stop_time / STEPS_AT_LEAST,
        "LARGEST_VIOLATION": limits.violation,
        "LARGEST_NORM": NORM,
        "LARGEST_OUTSIDE": OUTSIDE,
        "ENERGY_SHARE": limits.energy,
        "LOSS_SHARE": limits.loss,
        "LEAST_ENERGY": limits.least,
        "DRIFT_SHARE": CONSTRAINT_SHARE,
        "FAR": far_distance(system, *ideal),
        "FAR_TURNED": FAR_TURNED,
        "NOTICEABLE": NOTICEABLE,
        "RADIUS": float(length_scale(ideal[0].system(ideal[1]))),
    }
    lines = [
        "/* Written by spherejax: the equations of one mechanism as straight-line programs. */",
        programs.c_prelude,
        *(f"#define {name} {value}" for name, value in sizes.items()),
        *(f"#define {name} {_number(value)}" for name, value in levels.items()),
        f"#define VITALS {', '.join(field.upper() for field in Vitals._fields)}",
        _texts("value_names", [port.name for port in ports.values]),
        _texts("body_names", list(system.bodies)),
        _array("start_values", [port.start for port in ports.values]),
        _array("relative", relative),
        _array("absolute", absolute),
        _array("nominal", absolute / (ABSOLUTE_SHARE * experiment.rtol)),
        _array("stage_times", [0.0, *tableau.c[: n_stages - 1]]),
        _array("stage_weights", np.concatenate(tableau.a_lower[: n_stages - 1])),
        _array("weights", tableau.b_sol[:n_stages]),
        _array("error_weights", tableau.b_error[:n_stages]),
    ]
    return "\n".join([*lines, *programs.c_functions()]) + "\n"


def state_ports(system: System) -> list[Port]:
    """Names and units of the entries of the flat state."""
    bodies, layout = list(system.bodies), system.layout
    found = []
    for body in bodies:
        found += [Port(f"states.position.{body}.{letter}", "m") for letter in "xyz"]
        found += [Port(f"states.quaternion.{body}.{letter}", "1") for letter in "wxyz"]
    for body in bodies:
        found += [Port(f"states.velocity.{body}.{letter}", "m/s") for letter in "xyz"]
        found += [Port(f"states.angular_velocity.{body}.{letter}", "rad/s") for letter in "xyz"]
    found += [Port(f"states.{slot.joint}.{name}", "") for slot in system.all_slots for name in slot.names]
    found += [Port(f"states.work.{i}", "J") for i in range(layout.n_work)]
    return found


class Target(NamedTuple):
    """The system that a compiler writes code for.

    Attributes:
        platform: the folder of its library in the FMU, as FMI 3.0 names it: `x86_64-linux`, `aarch64-darwin`, ...
        suffix: of the library's file name.
        options: of the compiler, besides `OPTIONS`.
        libraries: what is linked.
    """

    platform: str
    suffix: str
    options: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ("-lm",)


ARCHITECTURES = {
    "x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64", "i386": "x86", "i486": "x86",
    "i586": "x86", "i686": "x86", "x86": "x86", "arm": "aarch32", "armv6l": "aarch32", "armv7l": "aarch32",
    "riscv64": "riscv64", "ppc64le": "ppc64le", "powerpc64le": "ppc64le",
}  # fmt: skip
"""Names of FMI 3.0 by those of compilers and operating systems."""


def target_of(compiler: str) -> Target:
    """The system that a C compiler writes code for, which is not this machine where the compiler is a cross compiler.

    Args:
        compiler: its path. GCC and Clang say by `-dumpmachine` what they compile for; of a compiler that does not, it
            is taken to be this machine.

    Raises:
        SceneError: where FMI 3.0 has no name for it.
    """
    asked = subprocess.run([compiler, "-dumpmachine"], capture_output=True, text=True, errors="replace", check=False)
    triple = asked.stdout.strip().lower() if asked.returncode == 0 else ""
    if not re.fullmatch(r"[\w.]+(-[\w.]+)+", triple):
        triple = f"{platform.machine().lower()}-{sys.platform}"
    architecture, _, rest = triple.partition("-")
    architecture = ARCHITECTURES.get(architecture)
    # x87 registers round to 64 bits whenever they please; SSE rounds each operation to 53.
    options = ("-msse2", "-mfpmath=sse") if architecture == "x86" else ()
    if architecture and any(word in rest for word in ("mingw", "windows", "win32")):
        # Without GCC's run-time library, which other machines lack. MSVC's C library contains the mathematics.
        is_gcc = "mingw" in rest
        more = (*options, "-static-libgcc") if is_gcc else options
        return Target(f"{architecture}-windows", ".dll", more, ("-lm",) if is_gcc else ())
    if architecture and ("darwin" in rest or "macos" in rest):
        return Target(f"{architecture}-darwin", ".dylib", (*options, "-fPIC"))
    if architecture and "linux" in rest:
        return Target(f"{architecture}-linux", ".so", (*options, "-fPIC"))
    raise SceneError(
        f"export_fmu: the C compiler {compiler!r} compiles for {triple!r}, for which FMI 3.0 has no name. Libraries in "
        "FMUs are for Linux, macOS (darwin) and Windows (by MinGW-w64 or Clang; Cygwin's need Cygwin). Choose another "
        'compiler by the environment variable CC, or export with kind="python"'
    )


def _indicators(system: System) -> list[str]:
    touches = [
        f"{name}.{i}" if system.forces[name].n_touches > 1 else name
        for name in system.touching_forces
        for i in range(system.forces[name].n_touches)
    ]
    return [f"events.{name}" for name in [*system.contact_joints, *touches]]


def _compiled(compiler: str, target: Target, folder: Path, source: str, instance: str) -> Path:
    (folder / "model.c").write_text(source, encoding="utf-8")
    (folder / "instance.c").write_text(instance, encoding="utf-8")
    library = folder / f"model{target.suffix}"
    command = [compiler, *OPTIONS, *target.options, "-o", str(library), str(folder / "model.c"), *target.libraries]
    # What a compiler says may be in the language, and the encoding, of the system.
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False, cwd=folder)
    if done.returncode:
        raise SceneError(f"export_fmu: {' '.join(command[:1])} failed:\n{done.stderr[:2000]}")
    return library


def _build_description(identifier: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{identifier}">\n    <SourceFileSet language="C99">\n'
        '      <SourceFile name="model.c"/>\n    </SourceFileSet>\n    <Library name="m"/>\n'
        "  </BuildConfiguration>\n</fmiBuildDescription>\n"
    )


_TERM = diffrax.ODETerm(lambda t, y, args: y)


def _texts(name: str, texts: Sequence[str]) -> str:
    """An array of texts: a name in a scene may have a quote, which would end a text of C and begin code."""
    quoted = ", ".join(_quoted(text) for text in texts) or '""'
    return f"static const char *{name}[] = {{{quoted}}};"


def _quoted(text: str) -> str:
    """A text of C: bytes other than plain letters in octal, always three digits; `?` too, because of trigraphs."""
    plain = set(range(32, 127)) - set(b'"\\?')
    return '"' + "".join(chr(byte) if byte in plain else f"\\{byte:03o}" for byte in text.encode()) + '"'


def _array(name: str, values: Any) -> str:
    flat = [_number(value) for value in np.ravel(np.asarray(values, np.float64))]
    return f"static const double {name}[] = {{{', '.join(flat) or '0'}}};"


def _number(value: Any) -> str:
    number = float(np.asarray(value))
    return "INFINITY" if np.isinf(number) else number.hex()
