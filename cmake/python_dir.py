"""Print where the running Python looks for packages below a prefix, relative to that prefix."""

import argparse
import sys
import sysconfig
from pathlib import Path


def python_dir(prefix: Path) -> Path:
    """Return the folder of packages that sys.path has below prefix, else the one to add to PYTHONPATH."""
    packages = [Path(entry) for entry in sys.path if entry.endswith(("dist-packages", "site-packages"))]
    # Only lib/pythonX: below /usr lies /usr/local as well, which is not what a prefix of /usr asks for.
    below = [entry.relative_to(prefix) for entry in packages if entry.is_relative_to(prefix / "lib")]
    if below:
        return below[0]
    # Debian's own scheme is the sign of a Python that reads dist-packages.
    folder = "dist-packages" if "deb_system" in sysconfig.get_scheme_names() else "site-packages"
    return Path("lib") / f"python{sys.version_info.major}.{sys.version_info.minor}" / folder


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prefix", type=Path)
    print(python_dir(parser.parse_args().prefix).as_posix())
