#!/usr/bin/env python3
"""A package for the Debian that this runs on: `make deb`.

    .venv/bin/python packaging/make_deb.py build

Installs into a staging folder as CMake does below /usr. Of requirements.txt, what this Debian has (python3-NAME)
becomes a dependency. What it lacks or has too old (ONNX Runtime, Matplotlib on Debian 12) goes into /usr/lib/gr-radalt
with what that needs in turn, in the versions of requirements.txt. Needs dpkg-deb, cmake, pip, apt's lists, the network.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
DEBIAN_NAME = {"pyyaml": "yaml", "pyzmq": "zmq", "python-dateutil": "dateutil", "pillow": "pil"}
OLDEST = {"matplotlib": "3.7"}  # legends outside the axes
SYSTEM = "/usr/bin/python3"
POSTINST = """#!/bin/sh
set -e
[ "$1" != configure ] || py3compile -p gr-radalt
"""
PRERM = """#!/bin/sh
set -e
py3clean -p gr-radalt
find /usr/share/gr-radalt /usr/lib/gr-radalt -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
"""


def run(*command: object) -> str:
    """What a command prints; ends this program with what it said where it fails."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"make_deb: {command[0]} ended with {done.returncode}: {done.stderr.strip() or done.stdout}")
    return done.stdout


def known(package: str, oldest: str = "0") -> bool:
    """Whether this Debian has it, in this version or a later one."""
    policy = subprocess.run(["apt-cache", "policy", package], capture_output=True, text=True, check=False)
    found = re.search(r"^ *Candidate: ([^(\s]+)", policy.stdout, re.MULTILINE)
    if not found:
        return False
    version = found[1].rpartition(":")[2]
    return subprocess.call(["dpkg", "--compare-versions", version, "ge", oldest]) == 0


def normal(name: str) -> str:
    """A name of a Python package as the index compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def debian_packages() -> list[str]:
    """Those of requirements-debian.txt that a user needs."""
    text = (ROOT / "requirements-debian.txt").read_text()
    lines = [re.sub(r"#.*|\s", "", line) for line in text.splitlines()]
    chosen = [next(filter(known, line.split("|")), None) for line in lines if line]
    build_only = {"cmake", "xvfb", "xauth", "xdotool", "python3-venv"}
    return [name for name in chosen if name and name not in build_only]


def bundle(folder: Path) -> list[str]:
    """Put what Debian lacks into folder; returns the Debian packages for the rest."""
    pins = {}
    for line in (ROOT / "requirements.txt").read_text().splitlines():
        pin, _, marker = line.partition("#")[0].partition(";")
        if pin.strip() and _holds(marker):
            pins[normal(re.match(r"[\w.-]+", pin)[0])] = pin.strip()
    depends, wanted, seen, oldest = [], list(pins), set(), dict(OLDEST)
    while wanted:
        name = normal(wanted.pop())
        if name in seen:
            continue
        seen.add(name)
        package = f"python3-{DEBIAN_NAME.get(name, name)}"
        if known(package, oldest.get(name, "0")):
            depends.append(package)
            continue
        print(f"make_deb: no {package} that is new enough; bundling {pins.get(name, name)}", flush=True)
        pip = (
            SYSTEM,
            "-m",
            "pip",
            "--disable-pip-version-check",
            "-q",
            "install",
            "--no-deps",
            "--no-compile",
        )
        run(*pip, "--upgrade", "--target", folder, pins.get(name, name))
        for found in importlib.metadata.distributions(path=[str(folder)]):
            for need in found.requires or []:
                text, _, marker = need.partition(";")
                needed, low = re.match(r"[\w.-]+", text)[0], re.search(r">=\s*([\d.]+)", text)
                if "extra" not in marker:
                    wanted.append(needed)
                    oldest.setdefault(normal(needed), low[1] if low else "0")
    shutil.rmtree(folder / "bin", ignore_errors=True)
    return depends


def _holds(marker: str) -> bool:
    """A marker of requirements.txt, which only compares python_version."""
    found = re.fullmatch(r'\s*python_version\s*(<|>=|==)\s*"(\d+)\.(\d+)"\s*', marker)
    if not found:
        return not marker.strip()
    here, there = sys.version_info[:2], (int(found[2]), int(found[3]))
    return {"<": here < there, ">=": here >= there, "==": here == there}[found[1]]


def control(version: str, architecture: str, depends: list[str], kilobytes: int) -> str:
    """The package's description."""
    low, high = sys.version_info[1], sys.version_info[1] + 1
    needs = [f"python3 (>= 3.{low})", f"python3 (<< 3.{high})", *sorted(set(depends))]
    return f"""Package: gr-radalt
Version: {version}
Architecture: {architecture}
Maintainer: gr-radalt maintainers <gr-radalt@localhost>
Installed-Size: {kilobytes}
Depends: {", ".join(needs)}
Section: hamradio
Priority: optional
Description: interference mitigation for FMCW radar altimeters
 GNU Radio blocks, flowgraphs and studies that measure how well an FMCW radar
 altimeter keeps its altitude under interference, over the air with two USRP
 B210s or through a simulated channel. The command is radalt.
"""


def main() -> int:
    """Build it; prints the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("build", type=Path, help="folder for the package and what it is made from")
    build = parser.parse_args().build.resolve()
    stage, made = build / "deb", build / "deb-cmake"
    shutil.rmtree(stage, ignore_errors=True)
    run("cmake", "-S", ROOT, "-B", made, "-DCMAKE_INSTALL_PREFIX=/usr", f"-DPYTHON_EXECUTABLE={SYSTEM}")
    os.environ["DESTDIR"] = str(stage)
    run("cmake", "--install", made)
    depends = debian_packages() + bundle(stage / "usr/lib/gr-radalt/lib" / PYTHON / "site-packages")
    for page in stage.glob("usr/share/man/man1/*.1"):
        run("gzip", "-9n", page)
    version = re.search(r"CMAKE_PROJECT_VERSION:\w+=(.*)", (made / "CMakeCache.txt").read_text())[1]
    architecture = run("dpkg", "--print-architecture").strip()
    size = sum(file.lstat().st_size for file in stage.rglob("*") if file.is_file()) // 1024
    (stage / "DEBIAN").mkdir()
    (stage / "DEBIAN/control").write_text(control(version, architecture, depends, size))
    for name, text in (("postinst", POSTINST), ("prerm", PRERM)):
        (stage / "DEBIAN" / name).write_text(text)
        (stage / "DEBIAN" / name).chmod(0o755)
    package = build / f"gr-radalt_{version}_{architecture}.deb"
    run("dpkg-deb", "--root-owner-group", "-Zzstd", "-z12", "--build", stage, package)
    print(package)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
