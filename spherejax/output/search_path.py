"""Programs are looked for on the PATH, and never in the working folder."""

import os
import shutil


def program_on_path(name: str) -> str | None:
    """The absolute path of a program on the PATH; None where there is none.

    `shutil.which` also searches the working folder, where the PATH has an empty or relative entry, and always on
    Windows. A program that lies in somebody's archive of scenes would be run then.

    Args:
        name: of the program. A name with a folder in it is taken as the user has written it.
    """
    if os.path.dirname(name):
        return shutil.which(name)
    folders = [folder for folder in os.environ.get("PATH", os.defpath).split(os.pathsep) if os.path.isabs(folder)]
    return next(filter(None, (shutil.which(os.path.join(folder, name)) for folder in folders)), None)
