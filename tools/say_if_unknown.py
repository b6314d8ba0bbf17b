"""Print a line to stderr if distribution, Python or GNU Radio is an untested one; never fails.

The set-up runs it in GNU Radio's Python, after it has found everything it needs, and continues.
"""

import argparse
import sys
from pathlib import Path

TESTED = {("debian", "12"), ("debian", "13")}
SUPPORTED = (
    "tested: Debian 12 and 13; expected to work: Ubuntu 22.04 to 24.04 and conda-forge, Python 3.10 to 3.13"
)


def distribution(os_release: str) -> tuple[str, str, str]:
    """Identity, version and name in the text of /etc/os-release."""
    pairs = (line.partition("=")[::2] for line in os_release.splitlines())
    known = {key: value.strip("\"'") for key, value in pairs}
    identity = known.get("ID", "")
    return identity, known.get("VERSION_ID", ""), known.get("PRETTY_NAME", identity or "unknown system")


def verdict(os_release: str, python: tuple[int, int], gnuradio: str) -> str:
    """The line, empty on a tested system."""
    identity, version, name = distribution(os_release)
    if (identity, version) in TESTED and (3, 10) <= python <= (3, 13) and gnuradio.startswith("3.10."):
        return ""
    here = f"{name}, Python {python[0]}.{python[1]}, GNU Radio {gnuradio}"
    return f"gr-radalt set-up: nobody has tested {here}; {SUPPORTED}; going on"


def main() -> None:
    """Print the verdict on this machine."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    from gnuradio import gr

    file = Path("/etc/os-release")
    said = verdict(file.read_text() if file.exists() else "", sys.version_info[:2], gr.version())
    if said:
        print(said, file=sys.stderr)


if __name__ == "__main__":
    main()
