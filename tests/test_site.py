"""The documentation site: it builds from the repository, and its pages work from a folder in Chromium."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt  # noqa: TID251  # the examples draw with it
import pytest

import surctl
from tests.browser import Opened, open_page
from tests.pictures import blank_pictures
from tests.processes import run_python
from tests.tools import PATIENCE, need_compiler, need_module

ROOT = Path(__file__).parents[1]
GUIDES = ROOT / "notebooks" / "guides"
TOOLS = ROOT / "notebooks" / "docsite"
EXAMPLES = sorted(path.stem for path in (ROOT / "notebooks" / "gallery").glob("*.py"))

# text nodes whose colour and ground differ by less than WCAG's 4.5 (3 for large text)
_CONTRAST = """() => {
  const channel = (c) => (c /= 255) <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (text) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = text; canvas.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, below) => [0, 1, 2].map((k) => top[k] * top[3] + below[k] * (1 - top[3]));
  const ground = (element) => {
    if (!element) return [255, 255, 255];
    const own = rgba(getComputedStyle(element).backgroundColor);
    return own[3] === 1 ? own : over(own, ground(element.parentElement));
  };
  const bad = new Set();
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const element = node.parentElement;
    if (!node.textContent.trim()) continue;
    if (!element.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    if (element.closest(".headerlink, .md-top, script, style")) continue;
    const box = element.getBoundingClientRect(), style = getComputedStyle(element);
    if (!box.width || !box.height) continue;
    let opacity = 1;
    for (let up = element; up; up = up.parentElement) opacity *= +getComputedStyle(up).opacity;
    const below = ground(element), colour = rgba(style.color);
    colour[3] *= opacity;
    const [a, b] = [light(over(colour, below)), light(below)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && +style.fontWeight >= 700);
    const name = `${element.tagName}.${element.className} ${node.textContent.trim().slice(0, 30)}`;
    if (ratio < (large ? 3 : 4.5)) bad.add(`${name}: ${ratio.toFixed(2)}`);
  }
  return [...bad];
}"""


_ENVIRONMENT = {"SURCTL_SITE": "quick", "SURCTL_SITE_VERSIONS": "1", "NO_MKDOCS_2_WARNING": "1"}


@pytest.fixture(scope="module")
def site(tools: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site without docstrings and without running the gallery; the build is strict about links and anchors.

    It lies in a folder of versions, as `publish.py` builds it, beside an older one with a single page.
    """
    need_module("material")
    folder = tmp_path_factory.mktemp("site") / surctl.__version__
    folder.mkdir()
    # without -q, with which mkdocs counts no warnings
    words = ["-m", "mkdocs", "build", "--strict", "-f", str(ROOT / "notebooks" / "mkdocs.yml"), "-d", str(folder)]
    done = run_python(words, cwd=folder, environment={**os.environ, **_ENVIRONMENT})
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stderr
    (folder.parent / "0.1" / "search").mkdir(parents=True)
    (folder.parent / "0.1" / "index.html").write_text("<title>old</title>", encoding="utf-8")
    from publish import list_versions

    assert list_versions(folder.parent) == [surctl.__version__, "0.1"]
    return folder


@pytest.fixture(scope="module")
def tools() -> Iterator[None]:
    """The modules of the build can be imported."""
    sys.path.insert(0, str(TOOLS))
    yield
    sys.path.remove(str(TOOLS))


def test_every_page_is_there_and_loads_nothing_from_another_host(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    names = {path.relative_to(site).as_posix() for path in pages}
    assert {
        "index.html", "tutorials/firmware.html", "reference/commands/tune.html", "reference/files/vehicle.html",
        "reference/python/system.html", "gallery/pendulum_lqr.html", "studies/26_examples.html", "glossary.html",
    } <= names  # fmt: skip
    loaded = re.compile(
        r'<(?:script|img|iframe|source)[^>]* src="(?:https?:)?//|<link[^>]*stylesheet[^>]*href="(?:https?:)?//'
    )
    assert [path.name for path in pages if loaded.search(path.read_text(encoding="utf-8"))] == []


def test_plots_and_animations_turn_dark_and_scenes_do_not(site: Path) -> None:
    sonar = (site / "explanation" / "sonar.html").read_text(encoding="utf-8")
    engine = (site / "studies" / "35_independent_engine.html").read_text(encoding="utf-8")
    assert re.search(r'<img class="plot"[^>]*tank-static\.gif', sonar)
    assert re.search(r'<img class="scene"[^>]*scene\.png', engine)


def test_formulas_commands_keys_and_terms_are_set(site: Path) -> None:
    text = {name: (site / f"{name}.html").read_text(encoding="utf-8") for name in (
        "explanation/priorities", "reference/commands/simulate", "reference/files/scenario", "reference/files/gains",
    )}  # fmt: skip
    assert text["explanation/priorities"].count("<math") > 15 and "arithmatex" not in text["explanation/priorities"]
    assert 'class="term" href="../glossary.html#jacobian"' in text["explanation/priorities"]
    assert "--random-worlds" in text["reference/commands/simulate"]
    assert "<code>spacing_m</code>" in text["reference/files/scenario"]
    assert "<code>lookahead</code>" in text["reference/files/gains"]
    found = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    assert any("from-plan" in entry["title"] for entry in found)


@pytest.mark.usefixtures("tools")
def test_formulas_of_docstrings_are_set_and_words_are_not() -> None:
    from formulas import as_mathml, with_mathml
    from prose_math import mark_formulas
    from unicode_math import as_tex

    said = (
        "<p>Return c &gt; 0 [1/s], so that V̇ ≤ −a V, V = ξᵀPξ; a (n, 4) array [m/s²] for <code>x = 1</code> (12).</p>"
    )
    shown = mark_formulas(said, lambda formula: f"[[{formula}]]")
    assert shown == said.replace("c &gt; 0", "[[c > 0]]").replace("V̇ ≤ −a V, V = ξᵀPξ", "[[V̇ ≤ −a V]], [[V = ξᵀPξ]]")
    shown = as_mathml(as_tex("q = √(y_e² + Δ²)/‖ẋ‖"))
    assert "<msqrt>" in shown and "<msubsup>" in shown and 'accent="true"' in shown
    assert "{" not in as_mathml("R_{OB} e^{-x}")
    assert as_mathml(as_tex("‖e‖²")).count('stretchy="false"') == 2
    shown = with_mathml(r'<div class="arithmatex">\[a = {b \qquad c}, \qquad d\]</div>')
    assert shown.startswith('<div class="formulas">') and shown.count("<math") == 2
    with pytest.raises(ValueError, match="frac"):
        as_mathml(r"\frac{1}")


def test_no_heading_goes_on_into_the_text_below_it(site: Path) -> None:
    headings = re.compile(r"<h[1-4][ >].*?</h[1-4]>", re.DOTALL)
    wrong = [
        (path.name, heading[:60])
        for path in sorted(site.rglob("*.html"))
        for heading in headings.findall(path.read_text(encoding="utf-8"))
        if "{ #" in heading or len(re.sub(r"<[^>]*>", "", heading)) > 130
    ]
    assert wrong == []


@pytest.mark.usefixtures("tools")
def test_words_of_commands_stay_whole() -> None:
    need_module("material")
    from command_pages import _plain
    from hooks import with_shared_names
    from wrapping import with_whole_words

    assert _plain("With --goals FILE, NAME=VALUE and `surctl check`: a_b") == (
        r"With `--goals FILE`, `NAME=VALUE` and `surctl check`: a\_b"
    )
    shown = with_whole_words("<p><code>surctl sweep --seeds 9</code> <code>analysis/08_sweep_scale/run.py</code></p>")
    assert '<code>surctl sweep <span class="whole">--seeds</span> 9</code>' in shown
    assert "<code>analysis/<wbr>08_sweep_scale/<wbr>run.py</code>" in shown
    assert '<code class="long">' in with_whole_words(f"<td><code>tests/{50 * 'x'}.py</code></td>")
    block = '<div class="language-text highlight"><pre><span></span><code>{}\n</code></pre></div>'
    assert with_whole_words(block.format("| (1)-(3) |")) == block.format("| (1)-(3) |")  # a drawing does not wrap
    assert 'class="language-console' in with_whole_words(block.format("python analysis/run.py --quick"))
    shared = '<b><code><span title="a">start,</span></code></b> (<code><span title="b">end</span></code>)'
    assert with_shared_names(shared) == "<b><code>start, end</code></b>"


@pytest.mark.usefixtures("tools")
def test_each_key_of_each_file_has_a_meaning() -> None:
    from file_pages import undocumented

    assert undocumented() == [], "write it in notebooks/docsite/file_meanings.py"


@pytest.mark.usefixtures("tools")
def test_each_package_is_in_the_reference_and_each_example_in_the_gallery() -> None:
    from api_pages import PACKAGES
    from gallery import EXAMPLES as SHOWN

    top = ROOT / "surctl"
    packages = {path.parent.name for path in top.glob("*/__init__.py")} - {"cli", "marine"}
    packages |= {f"marine.{path.parent.name}" for path in (top / "marine").glob("*/__init__.py")} - {"marine.cli"}
    packages |= {f"marine.{path.stem}" for path in (top / "marine").glob("[!_]*.py")}
    assert packages | {"assessment"} == set(PACKAGES)
    assert sorted(SHOWN) == EXAMPLES


@pytest.mark.usefixtures("tools")
def test_a_function_with_the_name_of_a_module_has_an_entry_of_its_own() -> None:
    from api_pages import directives, exported

    lines = directives("system", exported("system")[1]).splitlines()
    assert "::: surctl.system.from_control.from_control" in lines
    assert "        - to_control" in lines
    assert "        - from_control" not in lines


@pytest.mark.usefixtures("tools")
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs_and_draws(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from gallery import run_example

    need_compiler()
    blank_pictures(monkeypatch)
    plt.figure("before")  # as of an example that ran before in the process of the build
    shown = run_example(name)
    assert "before" not in plt.get_figlabels()
    assert shown.printed.strip() and shown.picture.startswith(b"\x89PNG")


# cells of tables beside the screen of a phone: a row is a card there
_HIDDEN = """() => [...document.querySelectorAll("td[data-label]")]
  .filter((cell) => cell.getBoundingClientRect().right > innerWidth).map((cell) => cell.textContent)"""
PAGES = (
    "index", "404", "explanation/priorities", "reference/equations", "reference/files/region",
    "reference/commands/export", "tutorials/own-vehicle", "studies/index", "studies/27_own_law", "gallery/index",
)  # fmt: skip
# options and short names in tables that go over two lines, and headings whose link makes a line of its own
_BROKEN = """() => {
  const short = [...document.querySelectorAll("td code")].filter((code) => /^\\S{1,24}$/.test(code.textContent));
  const all = [...document.querySelectorAll("article .whole"), ...short];
  const words = all.filter((word) => word.getClientRects().length > 1);
  const heads = [...document.querySelectorAll("article :is(h1, h2, h3):has(> .headerlink)")].filter((head) => {
    const text = document.createRange();
    text.setStart(head, 0); text.setEndBefore(head.querySelector(".headerlink"));
    return head.querySelector(".headerlink").getBoundingClientRect().bottom > text.getBoundingClientRect().bottom + 6;
  });
  return [...words, ...heads].map((element) => element.textContent);
}"""
_SIZES = "['h1', 'h2', 'h3'].map((name) => document.querySelector(`article ${name}`)).filter(Boolean)"


def test_pages_fit_and_can_be_read_in_both_schemes(site: Path) -> None:
    with open_page((site / "index.html").as_uri()) as opened:
        for scheme in ("light", "dark"):
            opened.page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            for name in PAGES:
                opened.page.evaluate("localStorage.clear()")
                opened.page.goto((site / f"{name}.html").as_uri())
                dark = opened.page.evaluate("document.body.dataset.mdColorScheme") == "slate"
                assert dark == (scheme == "dark")
                assert opened.page.evaluate(_CONTRAST) == [], (name, scheme)
                if scheme == "dark":  # only colours differ
                    continue
                for width in (1280, 400):
                    assert opened.overflow(width) <= 0, (name, width)
                    assert opened.page.evaluate(_BROKEN) == [], (name, width)
                    sizes = opened.page.evaluate(
                        f"{_SIZES}.map((head) => -parseFloat(getComputedStyle(head).fontSize))"
                    )
                    assert sizes == sorted(set(sizes)), (name, width)  # a lower heading is smaller
                assert opened.page.evaluate(_HIDDEN) == [], name
        search(opened, "exit status 1")  # lunr as it comes raises an error for digits
        opened.page.select_option("select.versions", "0.1")  # which has no such page
        opened.page.wait_for_url((site.parent / "0.1" / "index.html").as_uri())
        assert opened.errors == [] and opened.outside == []


ASKED = {
    "phase margin of my own plant": "questions/", "limit thrust": "questions/", "run on STM32": "questions/",
    "ROS": "questions/", "what does not proved mean": "what-is-proved", "resume a sweep": "questions/",
    "change the sampling time": "questions/", "anti-windup": "questions/", "Monte Carlo": "glossary",
    "time delay": "questions/", "state estimator": "questions/", "without compiler": "questions/",
    "license": "questions/",
    "cite": "project", "export to Simulink": "export", "what is a disk margin": "glossary",
    "vehicle oscillates": "field", "DVL": "questions/", "low battery": "questions/", "roll and pitch": "add-a-vehicle",
    "bumpless": "questions/", "battery sag": "add-a-vehicle", "refuted": "verify", "round tank": "questions/",
    "SITL": "field", "hardly shrinks": "verify",
    "neural network": "questions/", "feedforward": "questions/", "notch filter": "questions/", "bandwidth": "tune",
    "thermostat": "questions/", "FOC motor": "questions/", "satellite": "questions/", "lambda tuning": "questions/",
    "PREEMPT_RT": "questions/", "report a bug": "project", "not on PyPI": "questions/", "SMT solver": "certificates",
    "How do I run on SLURM?": "questions/", "Who gives support?": "questions/", "How do I cite surctl?": "project",
    "import GPX": "questions/", "Sobol indices": "questions/", "trusted computing base": "certificates",
    "Can I use surctl with PX4?": "questions/", "How do I call the controller from C++?": "questions/",
}  # fmt: skip


def test_what_a_newcomer_asks_is_answered_by_the_first_three_hits(site: Path) -> None:
    with open_page((site / "index.html").as_uri()) as opened:
        page, missed = opened.page, []
        hits = page.locator(".md-search-result__item")
        page.keyboard.press("/")
        for asked, answer in ASKED.items():
            page.keyboard.press("Control+A")
            page.keyboard.press("Backspace")
            hits.first.wait_for(state="detached", timeout=1000 * PATIENCE)  # those of the words before
            page.keyboard.insert_text(asked)
            page.keyboard.press("End")  # the page searches when a key is released
            hits.first.wait_for(timeout=1000 * PATIENCE)
            first = hits.evaluate_all("all => all.slice(0, 3).map(item => item.querySelector('a').href)")
            missed += [(asked, first)] * all(f"/{answer}" not in hit for hit in first)
        assert not missed


def search(opened: Opened, word: str) -> None:
    """The search finds pages although no server answers."""
    page = opened.page
    page.set_viewport_size({"width": 1280, "height": 900})
    page.keyboard.press("/")
    page.keyboard.type(word)
    page.wait_for_selector(".md-search-result__item", timeout=1000 * PATIENCE)
    assert page.locator(".md-search-result__item").count() >= 2


ABSENT = re.compile(
    r"absent|use python-control|use it on|python-control's|with python-control|python-control has|use Drake"
)
ELSEWHERE = {"dlqr", "hinfsyn"}  # functions of python-control


@pytest.mark.parametrize("tool", ["acados", "drake", "matlab", "pink", "python-control"])
def test_each_row_of_a_comparison_names_what_exists_or_says_why_not(tool: str) -> None:
    source = "\n".join(p.read_text(encoding="utf-8") for ext in ("py", "toml") for p in ROOT.glob(f"surctl/**/*.{ext}"))
    source = source.replace("-", "_")
    text = (GUIDES / "coming-from" / f"{tool}.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    rows = [row for row in rows if row[1] != "in surctl"]
    assert len(rows) > 15
    for feature, here, link in rows:
        code = re.findall(r"`([^`]*)`", here)
        assert code or "](" in link or ABSENT.search(here), feature
        for name in (n for part in code for n in re.findall(r"[A-Za-z_][\w-]{3,}", part)):
            assert name in ELSEWHERE or name.replace("-", "_") in source, (feature, name)
