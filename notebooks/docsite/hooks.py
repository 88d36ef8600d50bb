"""What MkDocs calls while it builds the site: generated pages, links that leave the guides, formulas, terms."""

from __future__ import annotations

import os
import posixpath
import re
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
for _folder in (HERE, ROOT):
    if str(_folder) not in sys.path:
        sys.path.insert(0, str(_folder))

import api_pages  # noqa: E402
import command_pages  # noqa: E402
import file_pages  # noqa: E402
import gallery  # noqa: E402
import repository  # noqa: E402
from formulas import as_mathml, equation_links, with_mathml  # noqa: E402
from glossary import link_terms, terms_of  # noqa: E402
from mkdocs.structure.files import File, Files  # noqa: E402
from notebook_pages import notebook_pages  # noqa: E402
from PIL import Image  # noqa: E402
from prose_math import mark_formulas  # noqa: E402
from unicode_math import as_tex  # noqa: E402
from wrapping import LONGEST, with_whole_words  # noqa: E402

import surctl  # noqa: E402

QUICK = os.environ.get("SURCTL_SITE") == "quick"
VERSIONED = "SURCTL_SITE_VERSIONS" in os.environ  # set by publish.py
_SOURCES: dict[str, Path] = {}  # page of the site → file of the repository that it shows
_TERMS: dict[str, str] = {}


def on_config(config: Any) -> Any:
    """Put the version into the header, and leave out in the quick form what takes long."""
    config.site_name = f"surctl {surctl.__version__}"
    config.extra["version_text"] = surctl.__version__
    if QUICK:
        config.plugins["mkdocstrings"].config.enabled = False
        config.extra_css = [name for name in config.extra_css if "mkdocstrings" not in str(name)]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add generated pages and what the pages of the repository link to, and complete the navigation."""
    guides = Path(config.docs_dir)
    _SOURCES.clear()
    _SOURCES.update({f.src_uri: Path(str(f.abs_src_path)) for f in files.documentation_pages()})
    examples, pictures = gallery.pages(run=not QUICK)
    generated = {
        "commands": command_pages.pages(),
        "files": file_pages.pages(),
        "python": api_pages.pages(quick=QUICK),
        "notebooks": notebook_pages(ROOT / "notebooks"),
        "gallery": examples,
    }
    for pages in generated.values():
        for page in pages:
            files.append(File.generated(config, page.uri, content=page.text))
            if page.source is not None:
                _SOURCES[page.uri] = page.source
    generated["studies"] = repository.studies()
    generated["changelog"] = [repository.changelog()]
    for page in repository.reached({**_SOURCES}, generated["studies"] + generated["changelog"], guides):
        if page.copied:
            files.append(File.generated(config, page.uri, abs_src_path=str(page.source)))
        else:
            files.append(File.generated(config, page.uri, content=page.text))
        _SOURCES[page.uri] = page.source
    for name, picture in pictures.items():
        files.append(File.generated(config, name, content=picture))
    for asset in sorted((HERE / "assets").iterdir()):
        files.append(File.generated(config, f"assets/{asset.name}", abs_src_path=str(asset)))
    config.nav = _filled(config.nav, generated)
    named = set(_named(config.nav))
    others = [file.src_uri for file in files.documentation_pages() if "/" not in file.src_uri]
    _section(config.nav, "How-to guides").extend(uri for uri in others if uri not in named)
    _TERMS.update(terms_of(guides / "glossary.md"))
    return files


def _filled(nav: list[Any], generated: dict[str, list[Any]]) -> list[Any]:
    filled: list[Any] = []
    for entry in nav:
        if isinstance(entry, str):
            filled.append(entry)
            continue
        ((title, content),) = entry.items()
        if isinstance(content, list):
            filled.append({title: _filled(content, generated)})
        elif content.startswith("*"):
            pages = generated[content[1:]]
            filled.append({title: [page.uri if page.index else {page.title: page.uri} for page in pages]})
        else:
            filled.append(entry)
    return filled


def _named(nav: Any) -> Iterator[str]:
    """Yield the pages of a navigation."""
    if isinstance(nav, str):
        yield nav
    for entry in nav.values() if isinstance(nav, dict) else nav if isinstance(nav, list) else ():
        yield from _named(entry)


def _section(nav: list[Any], title: str) -> list[Any]:
    return next(entry[title] for entry in nav if isinstance(entry, dict) and title in entry)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Adapt GitHub's Markdown, and point links that leave the guides to their pages on the site."""
    uri = page.file.src_uri
    if uri in ("index.md", "glossary.md"):  # alone in their section
        page.meta["hide"] = ["navigation"]
    if "search" not in page.meta:
        page.meta["search"] = {"boost": _boost(uri)}
    text = repository.as_python_markdown(markdown)
    if uri in _SOURCES:
        text = repository.relinked(text, uri, _SOURCES[uri], _SOURCES)
    return text


def _boost(uri: str) -> float:
    """Return the weight of a page in the search: guides and tutorials come before reference and notebooks."""
    if uri.startswith(("reference/python/", "tutorials/notebooks/", "coming-from/")):
        return 0.5
    return 1.0 if "/" in uri and not uri.startswith(("tutorials/", "explanation/", "questions/")) else 3.0


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Set formulas as MathML, and link equation numbers and terms of the glossary."""
    uri = page.file.src_uri
    html = with_mathml(html)
    html = re.sub(r"<img (?![^>]*class=)(?=[^>]*\.(?:png|svg|gif))", '<img class="plot" loading="lazy" ', html)
    # a click shows a picture in its full size
    html = re.sub(r'(<img class="plot"[^>]* src="([^"]+)"[^>]*>)(?!</?strong)', r'<a href="\2">\1</a>', html)
    html = re.sub(r'<img class="(plot)"[^>]* src="([^"]+)"', lambda found: _scene_or_plot(found, files, uri), html)
    up = "../" * uri.count("/")
    if uri.startswith("reference/python/"):
        html = mark_formulas(html, lambda formula: as_mathml(as_tex(formula)))
        html = equation_links(html, f"{up}reference/equations.html")
        html = with_shared_names(html)
    if not uri.startswith(("reference/python/", "studies/", "glossary", "changelog")):
        html = link_terms(html, _TERMS, f"{up}glossary.html")
    return with_whole_words(_TABLE.sub(_labelled, html))


def _scene_or_plot(found: re.Match[str], files: Files, uri: str) -> str:
    # plots are white, and turn dark with the page; the scene of an engine keeps its colours
    file = files.get_file_from_path(posixpath.normpath(posixpath.join(posixpath.dirname(uri), found[2])))
    if file is None or found[2].endswith(".svg"):
        return found[0]
    with Image.open(BytesIO(file.content_bytes)) as picture:
        white = min(picture.convert("RGB").getpixel((0, 0))) > 250
    return found[0] if white else found[0].replace('"plot"', '"scene"', 1)


def with_shared_names(html: str) -> str:
    """Join names that share a line of a docstring: its parser takes the second one for the type of the first."""
    return _SHARED.sub(lambda found: f"<b><code>{found[1]} {re.sub(r'<[^>]*>', '', found[2])}</code></b>", html)


_SHARED = re.compile(r"<b><code>(?:<span[^>]*>)?([^<]*,)(?:</span>)?</code></b>\s*\(<code>(.*?)</code>\)", re.DOTALL)


_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)


def _labelled(table: re.Match[str]) -> str:
    """Write the head of its column into every cell: on a phone, each row is a card (see site.css)."""
    heads = [re.sub(r"<[^>]*>", "", head).strip() for head in re.findall(r"<th\b[^>]*>(.*?)</th>", table[0], re.DOTALL)]

    def row(found: re.Match[str]) -> str:
        columns = iter(heads)
        cells = re.sub(r"<td(?=[ >])", lambda cell: f'<td data-label="{_attribute(next(columns, ""))}"', found[0])
        return _LONG_KEY.sub(r'\1 class="long"\2', cells)

    return re.sub(r"<tr>.*?</tr>", row, table[0], flags=re.DOTALL)


_LONG_KEY = re.compile(rf"(<tr>\s*<td[^>]*)(>\s*<code>[^<]{{{LONGEST + 1},}}</code>)")  # may wrap


def _attribute(text: str) -> str:
    return text.replace('"', "&quot;")


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Add the selector of the version to a page of a published site."""
    if not VERSIONED:
        return output
    up = "../" * page.file.src_uri.count("/")
    about = f'data-version="{surctl.__version__}" data-page="{page.file.dest_uri}" data-root="{up}"'
    scripts = f'<script src="{up}../versions.js"></script><script src="{up}assets/versions.js" {about}></script>'
    return output.replace("</body>", f"{scripts}</body>")


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """Let the page for a wrong address open from a folder, too: a server sends it for an address of any depth."""
    if template_name != "404.html":
        return output
    output = re.sub(r'\b(href|src)="/(?!/)', r'\1="', output)
    output = output.replace('"base": "/"', '"base": "."').replace('"search": "/', '"search": "')
    output = output.replace("<h1>404 - Not found</h1>", _NOT_FOUND)
    output = output.replace("<head>", f"<head><script>{_ROOT_OF_LINKS}</script>", 1)
    return re.sub(r'(<script id="__config".*?</script>)', rf"\1<script>{_ROOT_OF_SEARCH}</script>", output, count=1)


_NOT_FOUND = (
    "<h1>This page does not exist</h1><p>The address is wrong, or of another version. "
    'Search for the subject, or begin at the <a href="index.html">start page</a>.</p>'
)
_SERVED = 'if (location.protocol !== "file:")'
_ROOT_OF_LINKS = _SERVED + " document.write('<base href=\"/\">')"
_ROOT_OF_SEARCH = (
    f'{_SERVED} {{ const own = document.getElementById("__config"); '
    'own.textContent = own.textContent.replace(\'"base": "."\', \'"base": "/"\') }'
)


def on_post_build(config: Any) -> None:
    """Mend the search (lunr).

    The names of its nodes join digits, so that it confuses nodes and then fails. And of a question such as "what is a
    disk margin?", it takes "a" for the start of every word with a, and looks for a word that ends with "?". The words
    "surctl" and "use" are in most headings, so they say nothing about a question.
    """
    for worker in Path(config.site_dir).glob("assets/javascripts/workers/search.*.js"):
        text = _NODE.sub(r"\1+','}\3", worker.read_text(encoding="utf-8"))
        text, count = _ASKED.subn(lambda _: _WITHOUT_STOP_WORDS, text)
        assert count == 1, f"{worker}: another search than the one that is mended here"
        worker.write_text(text, encoding="utf-8")


_NODE = re.compile(r"((\w)=\2\+\w\+\w\.id)\}(return \2\b)")
_ASKED = re.compile(r"(?<=search\(e\)\{)(?=if\(e=e\.replace)")
_WITHOUT_STOP_WORDS = (
    r"let kept=e.split(/\s+/).map(w=>w.replace(/[?!.:]+$/,''))"
    r".filter(w=>w&&!/^(surctl|use|using)$/i.test(w)&&lunr.stopWordFilter(w.replace(/\W/g,'').toLowerCase()));"
    "if(kept.length)e=kept.join(' ');"
)
