"""The documentation's own programs, for its tests."""

import importlib.util
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
README = DOCS.parent / "README.md"
sys.path.append(str(DOCS / "extensions"))  # its modules import each other


EXTENSIONS = DOCS / "extensions"


def program(name: str):
    """A module of the folder `docs`, e.g. `"examples"` or `"extensions/mathml"`."""
    module_name = f"docs_{name.replace('/', '_')}"
    if module_name not in sys.modules:
        spec = importlib.util.spec_from_file_location(module_name, DOCS / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        if str(EXTENSIONS) not in sys.path:  # one extension imports another, as in a build
            sys.path.append(str(EXTENSIONS))
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        spec.loader.exec_module(module)
    return sys.modules[module_name]
