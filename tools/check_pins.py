#!/usr/bin/env python3
"""Check that the package index has every pin for every Python. Downloads and installs nothing; needs the network.

    .venv/bin/python tools/check_pins.py                  # Python 3.10 to 3.13
    .venv/bin/python tools/check_pins.py 3.12 3.14

requirements.txt and requirements-test.txt are resolved with their dependencies, training/requirements.txt (Python 3.11)
without, since those of PyTorch are gigabytes. Wheels only, for this machine's platform.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

# pip evaluates markers for its own Python, whatever --python-version says; they are evaluated here instead
from pip._vendor.packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent


def wanted(file: Path, python: str) -> list[str]:
    """Requirements of a file for one Python, with their markers evaluated."""
    lines = [line.split("#")[0].strip() for line in file.read_text().splitlines()]
    found = [Requirement(line) for line in lines if line]
    environment = {"python_version": python, "python_full_version": python + ".0"}
    return [f"{r.name}{r.specifier}" for r in found if r.marker is None or r.marker.evaluate(environment)]


def resolve(requirements: list[str], python: str, *options: str) -> str:
    """pip's error, empty if it found everything."""
    with tempfile.TemporaryDirectory() as nowhere:
        command = [sys.executable, "-m", "pip", "install", "-q", "--dry-run", "--ignore-installed"]
        command += ["--target", nowhere, "--only-binary=:all:", "--python-version", python]
        command += [*options, *requirements]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    return next((line for line in reversed(done.stderr.splitlines()) if "ERROR" in line), "pip failed")


def version(text: str) -> str:
    """Argument ``type=`` for a version of Python."""
    if not re.fullmatch(r"3\.\d{1,2}", text):
        raise argparse.ArgumentTypeError(f"it is {text[:40]!r}; it has to be a Python such as 3.12")
    return text


def main() -> int:
    """Resolve for each Python; returns 0 if everything was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("python", nargs="*", type=version, default=["3.10", "3.11", "3.12", "3.13"])
    failed = False
    for python in parser.parse_args().python:
        runtime = [
            *wanted(ROOT / "requirements.txt", python),
            *wanted(ROOT / "requirements-test.txt", python),
        ]
        parts = {"runtime and tests": (runtime, ())}
        if tuple(map(int, python.split("."))) >= (3, 11):
            parts["training"] = (wanted(ROOT / "training/requirements.txt", python), ("--no-deps",))
        for part, (requirements, options) in parts.items():
            complaint = resolve(requirements, python, *options)
            failed |= bool(complaint)
            numpy = next(r for r in requirements if r.startswith("numpy"))
            print(f"Python {python}, {part} ({numpy}): {complaint or 'resolved'}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
