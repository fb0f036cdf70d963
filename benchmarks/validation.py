"""Measured mechanisms: fits to records that others published, and predictions of what was held out.

    .venv/bin/python benchmarks/validation.py --data FOLDER             # all cases
    .venv/bin/python benchmarks/validation.py --data FOLDER furuta      # some of them

The records are not part of this project; `benchmarks/measured/records.py` says where each was published, and what its
columns must be. Writes `results/measured_CASE_TABLE.csv` and `docs/pictures/measured_CASE.png`.
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from machine import write
from matplotlib.figure import Figure
from measured import double, driven, emps, furuta, papers, pendulum

CASES = {
    "furuta": furuta.study,
    "emps": emps.study,
    "pendulum": pendulum.study,
    "double": double.study,
    "driven": driven.study,
    "papers": papers.study,
}
PICTURES = Path(__file__).parent.parent / "docs" / "pictures"


def main() -> None:
    """Run the cases that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the records")
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], help="cases; all without")
    asked = parser.parse_args()
    for name in asked.cases or CASES:
        command = f"python benchmarks/validation.py --data FOLDER {name}"
        for part, content in CASES[name](asked.data):
            if isinstance(content, Figure):
                content.savefig(PICTURES / f"measured_{name}.png", dpi=110)
            else:
                write(f"measured_{name}_{part}", command, content, ("scipy",))


if __name__ == "__main__":
    main()
