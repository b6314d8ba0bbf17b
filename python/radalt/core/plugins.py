"""Plugins: modules outside the package that register interferers, methods or radios.

``RADALT_PLUGINS=my_radar,my_method`` names modules (comma-separated, on Python's path), which are imported with the
first registry. Worker processes inherit the variable, so they know the same names as the command line.
"""

import importlib
import os

VARIABLE = "RADALT_PLUGINS"


def load_plugins() -> None:
    """Import the modules that `VARIABLE` names; every registry calls it when it is ready.

    Raises `ImportError`: the module, and why it cannot be imported.
    """
    for name in filter(None, (part.strip() for part in os.environ.get(VARIABLE, "").split(","))):
        try:
            importlib.import_module(name)
        except Exception as error:  # a plugin may raise anything
            reason = " ".join(str(error).split())
            raise ImportError(
                f"{VARIABLE} names {name!r}, which cannot be imported ({type(error).__name__}: {reason}); "
                "mend it, put its folder on PYTHONPATH, or unset the variable"
            ) from error
