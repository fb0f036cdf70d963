"""Figures. The only place that imports matplotlib, and only when one of its modules is imported.

Every function returns a `matplotlib.figure.Figure`; saving it is the caller's choice.
"""

from pathlib import Path

import matplotlib

# matplotlib reads the `matplotlibrc` of the working folder, which may be somebody else's archive of scenes. Colors and
# sizes may come from there, but not the one setting that starts a program for figures (LaTeX). A backend that the file
# names is imported by pyplot alone, which is not imported here.
if Path(matplotlib.matplotlib_fname()).resolve().parent == Path.cwd():
    matplotlib.rcParams["text.usetex"] = False
