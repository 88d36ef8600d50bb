"""Build the site of this version into a folder that keeps the sites of all versions, with a selector on every page.

    python notebooks/docsite/publish.py FOLDER

Writes FOLDER/VERSION/, FOLDER/versions.js with the pages of each version, and FOLDER/index.html, which leads to the
newest one. A site published before is not built again. The selector needs no server and no branches of git: each page
loads ../versions.js, so old pages list new versions, also from file://.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from packaging.version import Version

__all__ = ["list_versions", "main"]

ROOT = Path(__file__).parents[2]
_HOME = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>surctl</title>
<meta http-equiv="refresh" content="0; url={0}/index.html"></head>
<body><a href="{0}/index.html">surctl {0}</a></body></html>
"""


def list_versions(folder: Path) -> list[str]:
    """Write the list of the versions in a folder, and return them, the newest first."""
    sites = [path.parent for path in folder.glob("*/search") if (path.parent / "index.html").exists()]
    newest = sorted(sites, key=lambda path: (Version(path.name), path.name), reverse=True)
    pages = {site.name: sorted(page.relative_to(site).as_posix() for page in site.rglob("*.html")) for site in newest}
    (folder / "versions.js").write_text(f"window.surctlVersions = {json.dumps(pages)};\n", encoding="utf-8")
    if newest:
        (folder / "index.html").write_text(_HOME.format(newest[0].name), encoding="utf-8")
    return [site.name for site in newest]


def main(words: list[str]) -> int:
    """Build and list; 2 without a folder, the status of mkdocs if that fails."""
    if len(words) != 1 or words[0].startswith("-"):
        print(__doc__)
        return 0 if words in (["-h"], ["--help"]) else 2
    sys.path.insert(0, str(ROOT))
    from surctl import __version__

    folder = Path(words[0]).resolve()
    # without -q, with which mkdocs counts no warnings
    build = ["mkdocs", "build", "--strict", "-f", str(ROOT / "notebooks" / "mkdocs.yml")]
    command = [sys.executable, "-m", *build, "-d", str(folder / __version__)]
    status = subprocess.call(command, env={**os.environ, "SURCTL_SITE_VERSIONS": "1"})
    if status == 0:
        print("versions:", ", ".join(list_versions(folder)))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
