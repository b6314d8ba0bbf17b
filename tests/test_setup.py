"""Set-up: one pin for each package on each Python, package names that differ between releases, and its one-liners."""

import os
import re
import sys
from pathlib import Path

import pytest
import say_if_unknown
from packaging.requirements import Requirement
from waiting import ran

import radalt

PYTHONS = ("3.10", "3.11", "3.12", "3.13")


def requirements(file: Path) -> list[Requirement]:
    lines = (line.split("#")[0].strip() for line in file.read_text().splitlines())
    return [Requirement(line) for line in lines if line]


@pytest.mark.parametrize("python", PYTHONS)
def test_every_package_has_one_pin_for_each_python(root, python):
    found = [*requirements(root / "requirements.txt"), *requirements(root / "requirements-test.txt")]
    environment = {"python_version": python, "python_full_version": f"{python}.0"}
    wanted = [r for r in found if r.marker is None or r.marker.evaluate(environment)]
    assert {r.name for r in wanted} == {r.name for r in found}
    assert len(wanted) == len({r.name for r in found})
    assert all(str(r.specifier).startswith("==") for r in wanted)


@pytest.mark.parametrize(
    ("lock", "names", "pythons"),
    [
        ("requirements.lock", ("requirements.txt",), PYTHONS),
        ("requirements-test.lock", ("requirements.txt", "requirements-test.txt"), PYTHONS[1:]),
    ],
)
def test_every_pin_is_in_the_lock_with_the_hashes_of_its_files(root, lock, names, pythons):
    text = (root / lock).read_text()
    locked = set(re.findall(r"^([\w.-]+==[^ ]+)", text, re.MULTILINE))
    for wanted in (r for name in names for r in requirements(root / name)):
        needed = wanted.marker is None or any(wanted.marker.evaluate({"python_version": v}) for v in pythons)
        if needed:
            assert f"{wanted.name}{wanted.specifier}" in locked, "run: make lock"
    entries = re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]
    assert entries and all("--hash=sha256:" in entry for entry in entries)
    assert "http" not in text


FAKES = {
    "dpkg-query": """case " $INSTALLED " in *" $4 "*) printf installed ;; *) exit 1 ;; esac""",
    "apt-cache": """case " $HAS " in *" $2 "*) echo '  Candidate: 1.0' ;; *) echo '  Candidate: (none)' ;; esac""",
    "apt-get": """echo "apt-get $*" >>"$SAID" """,
    "id": "echo 0",
}


@pytest.fixture
def install(root, tmp_path):
    """Run the installer on a list with doubles of dpkg and apt: (exit status, what it said, what apt was asked)."""
    for name, script in FAKES.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    said = tmp_path / "said"

    def run(lines: str, *, installed: str = "", has: str = "") -> tuple[int, str, str]:
        (tmp_path / "list").write_text(lines)
        said.write_text("")
        environment = os.environ | {"INSTALLED": installed, "HAS": has, "SAID": str(said)}
        environment["PATH"] = f"{tmp_path}:{os.environ['PATH']}"
        done = ran(root / "tools/install-debian-packages.sh", "list", cwd=tmp_path, env=environment)
        return done.returncode, done.stderr, said.read_text()

    return run


LIST = "# a list\nradio   # the main thing\nold-name | new-name  # renamed\n"


@pytest.mark.parametrize(
    ("installed", "has", "chosen"),
    [
        *((f"radio {name}", "", "") for name in ("old-name", "new-name")),
        ("radio", "old-name new-name", "old-name"),
        ("radio", "new-name", "new-name"),
        ("radio new-name", "radio old-name new-name", "old-name"),
    ],
)
def test_first_name_of_the_distribution_is_installed_where_it_is_missing(install, installed, has, chosen):
    status, said, asked = install(LIST, installed=installed, has=has)
    assert (status, said) == (0, f"gr-radalt set-up: installing {chosen}\n" if chosen else "")
    assert (f"install --no-install-recommends {chosen}\n" in asked) == bool(asked) == bool(chosen)


def test_package_that_no_list_knows_is_named_and_set_up_goes_on(install):
    status, said, asked = install(LIST, installed="radio")
    assert status == 0 and asked.endswith(" update\n")
    assert said == "gr-radalt set-up: this distribution has no package old-name|new-name; going on without\n"


@pytest.mark.parametrize(
    ("os_release", "python", "named"),
    [
        ('PRETTY_NAME="Ubuntu 24.04 LTS"\nID=ubuntu\n', (3, 12), "Ubuntu 24.04 LTS, Python 3.12"),
        ("ID=debian\nVERSION_ID=13\n", (3, 14), "Python 3.14"),
        ("", (3, 9), "unknown system, Python 3.9"),
    ],
)
def test_unknown_distribution_or_python_is_one_line_with_what_is_supported(os_release, python, named):
    said = say_if_unknown.verdict(os_release, python, "3.10.12.0")
    assert "\n" not in said and named in said
    assert "Debian 12 and 13" in said and "Python 3.10 to 3.13" in said and said.endswith("going on")


def test_the_command_lies_next_to_the_environments_python(root, tmp_path):
    """As the set-up makes it: from any folder, the package of its tree, run as a module."""
    (tmp_path / "python").symlink_to(root / "python")
    environment = tmp_path / "env/bin"
    environment.mkdir(parents=True)
    (environment / "python").symlink_to(sys.executable)
    made = [f"VENV={tmp_path}/env", f"STAMPS={tmp_path}", "-o", f"{tmp_path}/debian", f"{environment}/radalt"]
    ran("make", *made, cwd=root, check=True)
    done = ran(environment / "radalt", "--version", cwd=tmp_path, env=os.environ | {"PYTHONPATH": ""})
    assert (done.stdout, done.stderr) == (f"radalt {radalt.__version__}\n", "")
