"""Every example of the documentation and of the README runs, and prints what the page shows."""

import re
import shlex

import pytest
from documentation import DOCS, README, program

from spherejax import cli

examples = program("examples")


SLOW = (
    "concepts/dynamics.md",
    "concepts/identification.md",
    "concepts/sensitivities.md",
    "concepts/periodic.md",
    "howto/compare.md",
    "howto/controllers.md",
    "howto/equations.md",
    "howto/exchange.md",
    "howto/fit.md",
    "howto/own_law.md",
    "howto/own_mechanism.md",
    "howto/rig.md",
    "howto/robots.md",
    "howto/sensitivity.md",
    "howto/solvers.md",
    "howto/swap_models.md",
    "howto/sweep.md",
    "howto/tolerances.md",
    "howto/which_joint.md",
    "concepts/wear.md",
    "howto/report.md",
    "concepts/linearization.md",
)
"""Pages that take a quarter of a minute or more, for what other tests run too."""


def pages():
    """All pages with examples."""
    for page in examples.pages():
        name = page.relative_to(DOCS).as_posix()
        yield pytest.param(page, id=name, marks=[pytest.mark.slow] * (name in SLOW))


@pytest.mark.parametrize("page", pages())
def test_examples_run(page, tmp_path):
    examples.run_page(page, tmp_path)


@pytest.mark.slow  # a minute and a half of compiling
def test_readme_runs(tmp_path):
    examples.run_page(README, tmp_path, also_shown=("toml",))


COMMANDS = "run|draw|compare|effects|accuracy|sweep|fit|sensitivity|tolerances|modes|rig|cycle|write|export|list"
COMMAND = re.compile(rf"^(?:    )?(?:\.venv/bin/)?(spherejax (?:{COMMANDS})\b.*)$")


def shown_commands():
    """Commands that are shown, and not run, on any page."""
    for page in (README, *sorted(DOCS.rglob("*.md"))):
        for line in page.read_text().replace("\\\n", " ").splitlines():
            if (found := COMMAND.match(line)) and "[" not in line:
                yield pytest.param(found[1], id=f"{page.name}: {found[1][:50]}")


@pytest.mark.parametrize("command", shown_commands())
def test_shown_commands_exist_with_their_options(command):
    words = shlex.split(command, comments=True)
    assert callable(cli.parser().parse_args(words[1:]).action)


PAGE = """
```python
x = 2
print("x is", x)
```

```text
x is {shown}
```

```{{code-block}} toml
:caption: it.toml

mass = 1
```

```python
from pathlib import Path

assert Path("it.toml").read_text() == "mass = 1\\n"
```
"""


def test_a_page_is_run_from_top_to_bottom(tmp_path, monkeypatch):
    monkeypatch.setattr(examples, "HERE", tmp_path / "docs")
    (tmp_path / "page.md").write_text(PAGE.format(shown="..."))
    examples.run_page(tmp_path / "page.md", tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PAGE.format(shown="3"), "line 8: the page shows"),
        ("```python\n1 / 0\n```\n", "ZeroDivisionError"),
        ("```console\nspherejax run no-such-scene\n```\n", "exit code 2"),
        ("```console\nls\n```\n", "runs spherejax alone"),
        ("```ruby\nputs 1\n```\n", "'ruby' are not run"),
        ("```{code-block} toml\nmass = 1\n```\n", "without :caption:"),
    ],
    ids=["other output", "error", "failed command", "other command", "other language", "no file"],
)
def test_a_failing_example_is_reported(text, message, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(examples, "HERE", tmp_path / "docs")
    (tmp_path / "page.md").write_text(text)
    with pytest.raises(examples.ExampleError, match=message):
        examples.run_page(tmp_path / "page.md", tmp_path)


@pytest.mark.parametrize(
    ("shown", "printed", "is_right"),
    [
        ("[0.283 -0.1 0.]  7", "[ 0.28312345 -0.1002  0. ] 7\n", True),
        ("0.283 m", "0.2836 m", False),
        ("1e-08 m", "1.4e-08 m", True),
        ("1e-08 m", "1.6e-08 m", False),
        ("~12 s", "5.5 s", True),
        ("~12 s", "500 s", False),
        ("12 s", "13 s", False),
        ("FMI 3.0 of arm2", "FMI 3.0 of arm2", True),
        ("FMI 3.0 of arm2", "FMI 3.0 of arm3", False),
        ("first\n...\nlast", "first\nsecond\nlast", True),
        ("9994... to 0.0010069... and ...e-16", "99941.2 to 0.00100691 and 2.2e-16", True),
        ("9994... N", "9984.1 N", False),
    ],
)
def test_numbers_on_a_page_are_the_printed_ones_rounded(shown, printed, is_right):
    if is_right:
        examples.compare(shown, printed, "here")
    else:
        with pytest.raises(examples.ExampleError, match="here: the page shows"):
            examples.compare(shown, printed, "here")
