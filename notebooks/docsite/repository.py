"""Files of the repository on the site: studies, the changelog, and whatever a page links to outside of the guides."""

from __future__ import annotations

import os
import re
from pathlib import Path
from posixpath import relpath

from page import Page

_UNSEARCHED = "---\nsearch:\n  exclude: true\n---\n"
_RARELY = "---\nsearch:\n  boost: 0.5\n---\n"

__all__ = ["as_python_markdown", "changelog", "reached", "relinked", "studies"]

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
_CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_PICTURES = (".png", ".gif", ".svg", ".jpg")
_QUICK = os.environ.get("SURCTL_SITE") == "quick"
_NAMES = {".py": "python", ".toml": "toml", ".md": "markdown", ".c": "c", ".csv": "text", ".json": "json"}


def studies() -> list[Page]:
    """Return the studies of `analysis/`, their table first."""
    index = ROOT / "analysis" / "README.md"
    files = [index, ROOT / "analysis" / "choosing.md", *sorted((ROOT / "analysis").glob("[0-9]*/README.md"))]
    return [Page(_uri(path), _title(path), _RARELY + _text(path), path, index=path == index) for path in files]


def changelog() -> Page:
    """Return the page of changes."""
    path = ROOT / "CHANGELOG.md"
    return Page("changelog.md", "Changelog", _RARELY + _text(path), path)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _title(path: Path) -> str:
    first = next((line[2:] for line in _text(path).splitlines() if line.startswith("# ")), path.stem)
    if not path.parent.name[:1].isdigit():
        return first
    question = re.sub(r"^Study \d+: ", "", first)
    return f"{path.parent.name[:2]} {question[:1].upper()}{question[1:]}"


def _uri(path: Path) -> str:
    """Return the address of a file of the repository on the site."""
    if path == ROOT / "CHANGELOG.md":
        return "changelog.md"
    if path == ROOT / "README.md":
        return "index.md"
    name = path.relative_to(ROOT).as_posix()
    guides = "notebooks/guides/"
    if name.startswith(guides):
        return name.removeprefix(guides)
    if re.fullmatch(r"notebooks/\w+\.py", name):
        return f"tutorials/notebooks/{path.stem}.md"
    if name.startswith("notebooks/gallery/"):
        return f"gallery/{path.stem}.md"
    if name.startswith("analysis/") and path.suffix == ".md":
        below = name.removeprefix("analysis/")
        if below.endswith("/README.md"):
            return f"studies/{below.removesuffix('/README.md')}.md"
        return "studies/" + below.replace("README", "index")
    return f"sources/{name}" + ("" if _copied(path) else ".md")


def _copied(path: Path) -> bool:
    # the quick form makes no page for each of a hundred systems
    return path.suffix in _PICTURES or (_QUICK and path.match("systems/*.toml"))


def _target(link: str, source: Path) -> Path | None:
    """Return the file that a link of a page means; the README of a folder."""
    if "://" in link or link.startswith(("mailto:", "/")):
        return None
    path = Path(os.path.normpath(source.parent / link))
    if path.is_dir():
        path = path / "README.md"
    return path if path.is_file() and path.is_relative_to(ROOT) else None


def reached(known: dict[str, Path], first: list[Page], guides: Path) -> list[Page]:
    """Return the pages `first`, and every further file to which they or the known pages link, directly or not."""
    found = {page.uri: page for page in first}
    waiting = [path for path in known.values() if path.suffix == ".md"] + [p.source for p in first if p.source]
    while waiting:
        source = waiting.pop()
        for _, link, _ in _LINK.findall(_CODE.sub("", _text(source))):
            path = _target(link, source)
            if path is None or path.is_relative_to(guides):
                continue
            uri = _uri(path)
            if uri in known or uri in found or uri == "index.md":
                continue
            if _copied(path):
                found[uri] = Page(uri, source=path, copied=True)
                continue
            if path.suffix == ".md":
                waiting.append(path)
                found[uri] = Page(uri, _title(path), _text(path), path)
            else:
                name = path.relative_to(ROOT).as_posix()
                head = name.replace("/", "/<wbr>")
                text = f"{_UNSEARCHED}# {head}\n\n````{_NAMES.get(path.suffix, 'text')}\n{_text(path).rstrip()}\n````\n"
                found[uri] = Page(uri, name, text, path)
    return list(found.values())


def relinked(text: str, uri: str, source: Path, pages: dict[str, Path]) -> str:
    """Return the page with each link to a file of the repository turned into the link to its page."""
    start = uri.rpartition("/")[0] or "."

    def one(found: re.Match[str]) -> str:
        path = _target(found[2], source)
        goal = None if path is None else _uri(path)
        if goal is None or (goal not in pages and goal != "index.md"):
            return found[0]
        return f"{found[1]}{relpath(goal, start)}{found[3]}"

    return _outside_code(text, lambda part: _LINK.sub(one, part))


def _outside_code(text: str, change):  # type: ignore[no-untyped-def]
    parts = re.split(r"(^````?.*?^````?$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if k % 2 else change(part) for k, part in enumerate(parts))


def as_python_markdown(text: str) -> str:
    """Return GitHub's Markdown with the blank lines that Python-Markdown needs before lists and after code."""

    def spaced(part: str) -> str:
        out: list[str] = []
        listed = False  # whether the paragraph began as a list
        for line in part.split("\n"):
            item = re.match(r"(?:[-*]|\d+\.) ", line) is not None
            if not (out and out[-1].strip()):
                listed = item
            elif item and not listed:
                out.append("")
                listed = True
            out.append(line)
        return "\n".join(out)

    parts = re.split(r"(^````?.*?^````?$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(f"\n{part}\n" if k % 2 else spaced(part) for k, part in enumerate(parts))
