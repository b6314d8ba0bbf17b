"""One version: the package says it, everything else agrees, a tag on this commit included."""

import re

import pytest
import yaml
from waiting import ran

from radalt import __version__


def test_every_file_that_names_the_version_names_the_packages(root):
    assert yaml.safe_load((root / "CITATION.cff").read_text())["version"] == __version__
    assert yaml.safe_load((root / "MANIFEST.yml").read_text().partition("\n---")[0])["version"] == __version__
    releases = re.findall(r"^## \[(.*?)\]", (root / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert releases[:2] == ["Unreleased", __version__]


def test_a_tag_on_this_commit_is_the_version(root):
    tags = ran("git", "tag", "--points-at", "HEAD", cwd=root).stdout.split()
    tags = [tag for tag in tags if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    # only a release is tagged; that all files state one version is the test above, on every commit
    if not tags:
        pytest.skip("this commit is no release: no tag vX.Y.Z is on it")
    assert tags == [f"v{__version__}"]


@pytest.mark.parametrize("at", ["workflows/test.yml", "ISSUE_TEMPLATE/bug.yml", "ISSUE_TEMPLATE/method.yml"])
def test_files_of_the_forge_are_yaml_and_call_what_is_there(root, at):
    text = (root / ".github" / at).read_text()
    assert yaml.safe_load(text)
    for script in re.findall(r"script: \[(.*)\]", text):
        for name in script.split(", "):
            assert (root / name).stat().st_mode & 0o111
