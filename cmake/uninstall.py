"""Remove the files that the last `cmake --install` wrote, and this module's own folders with them."""

import argparse
import shutil
import sys
from pathlib import Path

OWN_FOLDERS = ("gnuradio/radalt", "share/gr-radalt", "share/doc/gr-radalt")


def uninstall(manifest: Path) -> int:
    """Remove every file named in manifest and return how many there were."""
    files = [Path(line) for line in manifest.read_text().splitlines() if line]
    for file in files:
        file.unlink(missing_ok=True)
        for folder in file.parents:
            # Whole, for Python compiles into it what is in no manifest.
            if folder.as_posix().endswith(OWN_FOLDERS) and folder.is_dir():
                shutil.rmtree(folder)
    return len(files)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("manifest", type=Path, help="install_manifest.txt of the build folder")
    manifest_path = parser.parse_args().manifest
    if not manifest_path.is_file():
        sys.exit(f"{manifest_path}: not there, so nothing was installed from this build folder")
    print(f"removed {uninstall(manifest_path)} files")
