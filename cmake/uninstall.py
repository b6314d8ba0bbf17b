"""Remove what the last `make install` wrote: files of its manifest, own folders, and folders that are then empty."""

import argparse
import shutil
import sys
from pathlib import Path

# Whole: Python compiles into them, and pip installs, what is in no manifest.
OWN_FOLDERS = ("gnuradio/radalt", "-packages/radalt", "share/gr-radalt", "share/doc/gr-radalt")
PACKAGES = "lib/gr-radalt"
SYSTEM = (Path("/"), Path("/usr"), Path("/usr/local"), Path("/opt"))  # their empty folders stay


def uninstall(manifest: Path) -> int:
    """Remove every file named in manifest and return how many there were."""
    files = [Path(line) for line in manifest.read_text().splitlines() if line]
    prefix = next(file.parent.parent for file in files if file.as_posix().endswith("/bin/radalt"))
    for file in files:
        file.unlink(missing_ok=True)
        for folder in file.parents:
            if folder.as_posix().endswith(OWN_FOLDERS) and folder.is_dir():
                shutil.rmtree(folder)
    shutil.rmtree(prefix / PACKAGES, ignore_errors=True)
    if prefix not in SYSTEM:
        for folder in sorted({p for file in files for p in file.parents}, reverse=True):
            if folder.is_relative_to(prefix) and folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
    return len(files)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("manifest", type=Path, help="install_manifest.txt of the build folder")
    manifest_path = parser.parse_args().manifest
    if not manifest_path.is_file():
        sys.exit(f"{manifest_path}: not there, so nothing was installed from this build folder")
    print(f"removed {uninstall(manifest_path)} files")
    manifest_path.unlink()
