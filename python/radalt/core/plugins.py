"""Modules outside the package that register interferers, methods or radios of their own.

``RADALT_PLUGINS=my_radar,my_method`` names modules (comma-separated, on Python's path) that are imported with the first
registry. Processes inherit it, so a sweep's workers know what the command line knows.
"""

from __future__ import annotations

import importlib
import os

__all__ = ["VARIABLE", "load_plugins"]

VARIABLE = "RADALT_PLUGINS"


def load_plugins() -> None:
    """Import what `VARIABLE` names; called by each registry when it is ready.

    Raises
    ------
    ImportError
        One line: the module, and why it cannot be imported.
    """
    for name in filter(None, (part.strip() for part in os.environ.get(VARIABLE, "").split(","))):
        try:
            importlib.import_module(name)
        except Exception as error:  # somebody else's code: anything can come
            reason = " ".join(str(error).split())
            raise ImportError(
                f"{VARIABLE} names {name!r}, which cannot be imported ({type(error).__name__}: {reason}); "
                "mend it, put its folder on PYTHONPATH, or unset the variable"
            ) from error
