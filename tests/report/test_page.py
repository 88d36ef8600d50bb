from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from surctl.assessment import Line
from surctl.errors import InputError
from surctl.export import ExportedFile, SilReport
from surctl.export.sil import Difference
from surctl.files import write_file
from surctl.marine.control import write_gains
from surctl.marine.report import ReportData, plot_run, render_page
from surctl.marine.report.evidence_sections import runs_section
from surctl.report.document import Heading, Section, picture, render_sections
from surctl.report.study_page import export_section
from surctl.report.theme import png
from surctl.verification import LoopCorners
from tests.pictures import blank_pictures
from tests.report.data import GAINS, report, run, said, sweep, vehicle
from tests.report.reader import Reader
from tests.report.test_titles import outside


@pytest.fixture(scope="module")
def drawn() -> tuple[str, list[Figure]]:
    """The page, with blank pictures, and the figures that were plotted for it."""
    figures: list[Figure] = []

    def keep(figure: Figure, **metadata: str | None) -> bytes:
        figures.append(figure)
        return png(figure, **metadata)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("surctl.report.document.png", keep)
        blank_pictures(patch)
        return render_page(report()), figures


@pytest.fixture(scope="module")
def page(drawn: tuple[str, list[Figure]]) -> str:
    return drawn[0]


@pytest.fixture(scope="module")
def pictured(drawn: tuple[str, list[Figure]]) -> list[Figure]:
    return drawn[1]


def bare(**parts: object) -> ReportData:
    """A page without pictures, for tests of its words."""
    plain = ReportData(title="t", command="surctl study", version="0", vehicle=vehicle(), gains=GAINS)
    return replace(plain, **parts)  # type: ignore[arg-type]


def with_margins(**changes: object) -> LoopCorners:
    """The linear analysis of the report, with other margins of the nominal loops."""
    linear = report().linear
    assert linear is not None
    nominal = replace(linear.nominal)
    vars(nominal)["margins"] = tuple(replace(m, **changes) for m in linear.nominal.margins)  # type: ignore[arg-type]
    return replace(linear, nominal=nominal)


def sil(**changes: object) -> SilReport:
    none = Difference(0.0, 0.0, 0.0, None)
    good = SilReport("c", "1f", 400, (), none, none, none, 0, 837, (), True, "cc 12", 185992)
    return replace(good, **changes)  # type: ignore[arg-type]


def test_the_page_is_balanced_and_its_anchors_meet(page: str) -> None:
    read = Reader(page)
    assert read.mistakes == []
    ids = [a["id"] for _, a in read.elements if "id" in a]
    assert len(set(ids)) == len(ids)
    targets = {(a["href"] or "").removeprefix("#") for a in read.all("a")}
    sections = {"vehicle", "gains", "margins", "loops", "sweep", "claims", "runs", "time"}
    parts = {"claims-v1-printed", "claims-m-norm-printed", "claims-v1-corrected", "runs-1", "runs-2"}
    assert targets == {"summary", *sections, *parts} - {"runs-2"} and targets <= set(ids)
    labels = {a["aria-labelledby"] for _, a in read.elements if "aria-labelledby" in a}
    assert labels <= set(ids)


def test_nothing_is_fetched_from_anywhere(page: str) -> None:
    assert not re.search(r"(https?:)?//[a-z]", re.sub(r'"data:[^"]*"', "", page))
    read = Reader(page)
    assert [a.get("type") for a in read.all("script")] == ["application/json", None]  # frames, and what plays them
    assert not read.all("link") and not read.all("iframe")
    assert "@import" not in page and "url(" not in page
    assert "default-src 'none'" in str(read.all("meta"))


def test_every_picture_is_inside_and_told_in_words(page: str) -> None:
    images = Reader(page).all("img")
    # loops 2, heat maps 4, claims 2 + 1, runs 2 × 2, priorities of the run that decides
    assert len(images) == 2 + 4 + 3 + 4 + 1
    for image in images:
        kind, _, content = (image["src"] or "").partition(",")
        assert kind == "data:image/png;base64"
        raw = base64.b64decode(content, validate=True)
        assert raw.startswith(b"\x89PNG")
        assert [int.from_bytes(raw[k : k + 4], "big") for k in (16, 20)] == [
            int(image["width"] or 0),
            int(image["height"] or 0),
        ]
        assert len(image["alt"] or "") > 20
    assert page.count("Command: <code>") == len(images)


def test_no_title_of_a_picture_is_clipped(pictured: list[Figure]) -> None:
    """Of every third one; study 40 looks at all."""
    assert len(pictured) > 12
    for figure in pictured[::3]:
        assert outside(figure) == []


@pytest.mark.usefixtures("blank")
def test_the_same_data_gives_the_same_page(page: str) -> None:
    assert render_page(report(), runs=runs_section(report())) == page  # drawn before


def test_the_same_plot_gives_the_same_bytes() -> None:
    first, again = (picture(plot_run(run()), alt="a run", caption="", command="").uri for _ in range(2))
    assert first == again


def test_many_runs_do_not_make_the_page_grow_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    blank_pictures(monkeypatch)
    size = sum(len(one) for one in re.findall(r'<img[^>]*src="([^"]*)"', render_page(bare(runs=(run(),)))))
    monkeypatch.setattr("surctl.marine.report.evidence_sections._BUDGET", 2.5 * size)
    flown = run(sensing="sonar")
    stopped = replace(flown, metrics=replace(flown.metrics, reached=False, stopped_because="collision"))
    many = render_page(bare(runs=(stopped,) * 40))
    drawn = len(Reader(many).all("img")) // 2
    assert 1 < drawn < 5 and f"{40 - drawn} more runs are only in the table" in many
    assert len(many) < 10 * size + 200_000


@pytest.mark.usefixtures("blank")
def test_no_option_of_a_command_is_broken_at_its_hyphens() -> None:
    page = render_page(bare(command="surctl study --out 'a b'"))
    assert '<code>surctl study <span class="whole">--out</span> &#x27;a b&#x27;</code>' in page


def test_names_are_escaped_and_never_run() -> None:
    evil = """<script>alert('1')</script>"$x_{&amp;}$ 潜\n"""
    base = run()
    car = replace(base.vehicle, name=evil, note=evil)
    leg = replace(base.scenario, name=evil, title=evil, source=evil)
    data = bare(
        title=evil, command=evil, version=evil, vehicle=car, gains=replace(GAINS, name=evil, provenance=evil),
        runs=(replace(base, scenario=leg, vehicle=car),), assessment=said(Line(True, evil)), seconds={evil: 1.0},
        export=export_section(evil, [ExportedFile(Path("a<b>.c"), evil)], []),
    )  # fmt: skip
    page = render_page(data)
    read = Reader(page)
    assert read.mistakes == [] and page.count("<script") == len(read.all("script")) == 2  # the player's
    assert "<script>alert('1')</script>\"$x_{&amp;}$ 潜" in read.text
    assert all("onerror" not in a and "onload" not in a for _, a in read.elements)


@pytest.mark.usefixtures("blank")
def test_numbers_that_are_none_or_endless_are_written_as_signs() -> None:
    base = run()
    lost = replace(base, metrics=replace(base.metrics, path_error_m=float("nan"), min_clearance_m=float("inf")))
    linear = with_margins(gain_margin=float("inf"), phase_margin_deg=float("nan"))
    read = Reader(render_page(bare(runs=(lost,), linear=linear, sweep=sweep(), seconds={"s": float("nan")})))
    text = re.sub(r"NaN and infinity", "", read.text)
    assert not re.search(r"\b(nan|inf|NaN|None)\b", text)
    assert "surge stable ∞ 0 –" in text


@pytest.mark.parametrize(
    ("lines", "first"),
    [
        ((Line(True, "a"), Line(None, "b", counts=False)), "✓ accepted: All that is assessed holds."),
        ((Line(True, "a"), Line(False, "b"), Line(False, "c")), "✗ NOT accepted: Fails: b (and 1 more)"),
        ((Line(None, "b", counts=False),), "• Nothing is assessed."),
    ],
)
def test_the_outcome_stands_first(lines: tuple[Line, ...], first: str) -> None:
    text = Reader(render_page(bare(assessment=said(*lines)))).text
    assert first in text and text.index(first) < text.index("Parameters of vehicle sur540-flooded")


def test_what_fails_comes_first_and_leads_to_where_more_is_told() -> None:
    lines = (
        Line(None, "sonar does not decide", "runs-2", counts=False),
        Line(True, "margins suffice", "margins"),
        Line(False, "run 9 is not drawn", "runs-9"),
        Line(False, "nothing tells of it", "nowhere"),
        Line(True, "no link"),
    )
    told = render_sections(
        title="t", subject="s", version="0", command="", passed=False, banner="x", lines=lines,
        sections=(Section("margins", "Margins", ()), Section("runs", "Runs", (Heading("two", "runs-2"), Heading("x")))),
    )  # fmt: skip
    (items,) = re.findall(r'<ul class="checks">(.*?)</ul>', told, re.DOTALL)
    words = ["run 9", "nothing tells", "margins suffice", "no link", "sonar does not"]
    assert sorted(words, key=items.index) == words
    assert re.findall(r'href="#([^"]*)"', items) == ["runs", "margins", "runs-2"]
    assert told.index("run 9 is not drawn") < told.index("<nav") < told.index('id="margins"')
    (contents,) = re.findall(r"<nav.*?</nav>", told, re.DOTALL)
    assert re.findall(r'href="#([^"]*)"', contents) == ["margins", "runs"]
    assert "<details" not in told  # nothing is folded where no section is


def headings(page: str) -> list[tuple[str, str, bool]]:
    """Level, text and whether it is in a folded part, of each heading from the top."""
    found, depth = [], 0
    for tag, level, text in re.findall(r"<(/?details|h([1-6])[^>]*>(.*?)</h)", page):
        depth += {"details": 1, "/details": -1}.get(tag, 0)
        if level:
            found.append((level, text, depth > 0))
    return found


def test_the_page_reads_from_the_verdict_to_the_parameters(page: str) -> None:
    found = headings(page)
    assert [(text, folded) for level, text, folded in found if level < "3"] == [
        ("Study default", False),
        ("Verdict", False),
        ("Decisive run", False),
        ("Margins and claims", False),
        ("Margins of each loop", True),
        ("Evidence for each claim", True),
        ("Closed-loop runs", True),
        ("Sweep of the gains", True),
        ("Computing time", True),
        ("Parameters of vehicle sur540-flooded", False),
        ("Gains default", False),
    ]
    levels = [int(level) for level, _, _ in found]
    assert levels[0] == 1 and all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert all("open" not in a for a in Reader(page).all("details"))
    assert page.index("data-player") < page.index('id="margins"')


def test_every_parameter_and_gain_is_listed_with_its_provenance(page: str) -> None:
    text = Reader(page).text
    for name, p in vehicle().parameters.items():
        assert name in text and p.provenance in text
    for name in GAINS.values:
        assert f"{name} " in text
    assert "Also simulated: sur400" in text
    assert "stands 0.05 m out of the water" in text  # E16


def test_a_run_says_whether_it_counts_and_how_to_repeat_it(page: str) -> None:
    text = Reader(page).text
    heads = "seed reached stopped because counts time [s] paper's time [s] least clearance [m]"
    m = run().metrics
    row = f"truth 0 yes reached yes {m.time_s:.4g} – {m.min_clearance_m:.3g}"
    assert heads in text and row in text and "sonar 0 yes reached no" in text
    assert "(does not count towards the result)" in text
    command = "surctl simulate pool-behind --vehicle sur400 --gains default --law guarded --avoidance corrected "
    assert command + "--priority-mode nsb --sensing sonar --seed 0 --out plots" in text
    assert report().decides == (True, False)
    assert replace(report(), deciding=(False, True)).decides == (False, True)
    with pytest.raises(InputError, match="deciding"):
        replace(report(), deciding=(True,))


@pytest.mark.usefixtures("blank")
def test_a_command_names_the_gain_file_only_if_it_holds_these_gains(tmp_path: Path) -> None:
    tuned = GAINS.with_values({"k_v": 2.0})
    flown = replace(run(), gains=tuned)
    unknown = Reader(render_page(bare(gains=tuned, runs=(flown,)))).text
    assert "surctl simulate" not in unknown and "Command: surctl study" in unknown
    file = tmp_path / "gains.toml"
    file.write_text(write_gains(tuned), encoding="utf-8")
    known = Reader(render_page(bare(gains=tuned, runs=(flown,), gains_file=str(file)))).text
    assert f"--gains {file} --law guarded" in known


def test_a_claim_comes_with_its_counterexample_or_what_is_left(page: str) -> None:
    text = Reader(page).text
    found = report().verdicts[0].counterexample
    assert found is not None
    for value in found.values.values():
        assert f"{value:.8g}" in text
    assert "Counterexample to v1-printed" in text and "Counterexample to v1-corrected" not in text
    assert re.search(r"Not proved: .* 256 samples", text)
    assert "surctl verify v1-printed --vehicle sur540-flooded --gains default --cruise 0.15 --cap 0.22" in text
    wrong = replace(report().verdicts[2], claim=replace(report().verdicts[2].claim, expected="refuted"))
    assert "which was NOT expected" in render_page(bare(verdicts=(wrong,)))


@pytest.mark.parametrize(
    ("changes", "said", "passed"),
    [
        ({}, "bad inputs: 837 cases, 0 failures cc 12, 185992 bytes", True),
        ({"tau": Difference(1.0, 0.5, 2e-12, 7)}, "thrust 2.0e-12", False),
        ({"fault_failures": ("<x[0]>",)}, "failed: <x[0]>", False),
        ({"self_test": False}, "self-test FAILED", False),
        ({"resets": (3,)}, "state loaded anew 1 times", False),
        ({"status_mismatches": 2, "code_bytes": None}, "2 of 400 steps differ", False),
    ],
)
def test_the_export_says_what_was_compared(tmp_path: Path, changes: dict[str, object], said: str, passed: bool) -> None:
    file = tmp_path / "c.c"
    file.write_bytes(b"x" * 12345)
    gone = ExportedFile(tmp_path / "gone.h", "ef")
    export = export_section("C.", (ExportedFile(file, "ab12"), gone), (sil(**changes),))
    page = Reader(render_page(bare(export=export)))
    assert said in page.text and "c.c 12 345 ab12" in page.text and "gone.h – ef" in page.text
    assert [block.mark for block in export.blocks if getattr(block, "mark", "")] == ["good" if passed else "bad"]


def test_an_export_that_was_not_compiled_says_so() -> None:
    export = export_section("No compiler.", (), ())
    text = Reader(render_page(bare(export=export))).text
    assert "No compiler." in text and "not compiled and not compared" in text


@pytest.mark.usefixtures("blank")
def test_a_sweep_without_a_feasible_point_says_so() -> None:
    assert "No point is feasible" in render_page(bare(sweep=sweep(picked=None)))


@pytest.mark.usefixtures("blank")
def test_an_unstable_loop_is_drawn_and_told() -> None:
    linear = with_margins(stable=False, disk_margin=0.0)
    text = Reader(render_page(bare(linear=linear, loops=report().loops))).text
    assert "surge not stable" in text and "where it tolerates the least delay" in text


def test_writing_replaces_the_file_in_one_step(tmp_path: Path) -> None:
    target = tmp_path / "new" / "report.html"
    assert write_file(target, render_page(bare(title="one"))) == target
    write_file(target, render_page(bare(title="two")))
    assert "<h1>two</h1>" in target.read_text(encoding="utf-8")
    assert [p.name for p in target.parent.iterdir()] == ["report.html"]


def blocked(tmp_path: Path) -> Iterator[Path]:
    file = tmp_path / "file"
    file.write_text("x")
    folder = tmp_path / "folder"
    folder.mkdir()
    yield file / "report.html"
    yield folder


def test_a_folder_that_cannot_be_written_is_told_in_one_line(tmp_path: Path) -> None:
    for target in blocked(tmp_path):
        with pytest.raises(InputError, match="cannot be written") as caught:
            write_file(target, "page")
        assert str(target) in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.glob(".*"))


def luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: float, other: float) -> float:
    return (max(one, other) + 0.05) / (min(one, other) + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["good", "bad", "note", "ink", "soft", "link"])
def test_text_contrast_reaches_wcag_aa(page: str, name: str, scheme: str) -> None:
    light, dark = re.findall(r":root \{.*?\}", page, re.DOTALL)
    colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", {"light": light, "dark": dark}[scheme]))
    for ground in {colours.get(f"{name}-ground", colours["ground"]), colours["ground"], colours["page"]}:
        assert contrast(luminance(colours[name]), luminance(ground)) >= 4.5


def test_the_linear_side_stands_beside_the_margins(page: str) -> None:
    loops = report().linear
    assert loops is not None
    text = Reader(page).text
    assert "Disk margins of all loops at once" in text and f"worst of {loops.of}" in text
    for disk in (*loops.nominal.disks, *loops.disks):
        assert f"{disk.guaranteed:.3g}" in text and f"{disk.phase_deg:.3g}" in text
    assert "Disk margins" not in render_page(bare())


def test_what_the_first_line_quotes_is_not_said_twice() -> None:
    kind = {"title": "Hull", "subject": "", "version": "1", "command": "", "sections": []}
    lines = [Line(None, "no region"), Line(True, "margins")]
    for banner, times in (("Nothing fails; open: no region", 1), ("Nothing fails; open: no region (and 1 more)", 2)):
        assert render_sections(passed=None, banner=banner, lines=lines, **kind).count("no region") == times
