import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck.turning_claim import read_claim
from surctl.certcheck.turning_law import true_rate
from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.report.files import plot_region, save_margins, save_verdicts
from surctl.marine.report.margin_plots import _rim
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.portrait import CRUISE_PLANES, portrait
from surctl.report.evidence import plot_open_boxes
from surctl.verification import decide, falsify

CERTIFICATES = Path(__file__).parents[1] / "certcheck"
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default").values


def certificate(name: str) -> dict[str, Any]:
    return json.loads((CERTIFICATES / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("plane", CRUISE_PLANES)
def test_nothing_fails_where_the_certificate_holds(plane: str) -> None:
    seen = portrait(certificate("region-cruise-20"), plane, points=41)
    inside = (seen.level <= 1.0) & (seen.level >= seen.levels[0])
    assert inside.sum() > 80 and seen.excess[inside].max() < 0
    assert seen.excess.max() > 0 or plane == "place"  # and far out it does fail


def test_the_flow_is_that_of_the_loop_written_for_the_checkers_tests() -> None:
    document = certificate("region-cruise-20")
    seen, claim = portrait(document, "across"), document["claim"]
    y, velocity = (grid.ravel() for grid in np.meshgrid(seen.x, seen.y))
    stated, n = read_claim(claim), len(y)
    state = np.stack([0 * y, y, 0 * y + claim["law"]["cruise"], velocity], axis=1)
    ones = {key: np.ones((n, 2)) for key in ("mass", "linear", "quadratic")}
    ones |= {"term_mass": np.ones(n), "term": np.ones(n)}
    rates = true_rate(stated, ones, state, np.zeros(n), np.zeros(n))
    assert seen.flow[0].ravel() == pytest.approx(rates[:, 1], abs=1e-12)
    assert seen.flow[1].ravel() == pytest.approx(rates[:, 3], abs=1e-12)


@pytest.mark.usefixtures("blank")
def test_a_portrait_needs_a_region(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surctl.marine.report.files.portrait", partial(portrait, points=15))
    with pytest.raises(InputError, match="level sets"):
        portrait({"kind": "interval", "claim": {}}, "along")
    with pytest.raises(InputError, match="across"):
        portrait(certificate("region-cruise-20"), "acros")
    scales = [ax.get_aspect() for ax in plot_region(certificate("region-cruise-20-lag")).axes]
    assert scales == ["auto", "auto", 1.0]  # the last plane has two positions


@pytest.mark.usefixtures("blank")
def test_claims_leave_pictures_of_what_came_of_them(tmp_path: Path) -> None:
    refuted, proved = claims(GAINS, ["v1-printed", "v1-corrected"])
    settled = decide(proved)
    box = {v.name: [v.lower, (v.lower + v.upper) / 2] for v in proved.variables}
    left = replace(falsify(proved), verdict="unknown", open_boxes=(box,))
    names = {p.name for p in save_verdicts([falsify(refuted), settled, left], tmp_path)}
    assert names == {
        "v1-printed-replay.png", "v1-printed-slice.png", "v1-corrected-open.png",
    }  # fmt: skip
    with pytest.raises(InputError, match="no open boxes"):
        plot_open_boxes(settled)


@pytest.mark.usefixtures("blank")
def test_loops_are_saved_with_their_disk_margin_unless_unstable(tmp_path: Path) -> None:
    law, gains = build_law("guarded"), load_gains("default")
    saved = {p.name for p in save_margins(law, VEHICLE, gains, tmp_path, cruise=[0.1, 0.2])}
    assert len(saved) == 3 and saved > {f"margins-sur540-flooded-{n}.png" for n in ("yaw", "disk")}
    unstable = gains.with_values({"k_psi": 60.0})
    assert not any("disk" in p.name for p in save_margins(law, VEHICLE, unstable, tmp_path, cruise=0.2))


def test_the_rim_of_gains_and_phases_ends_where_the_disk_margin_says() -> None:
    gain, phase = _rim(0.8)
    assert gain.max() == pytest.approx(2.8 / 1.2) and gain.min() == pytest.approx(1.2 / 2.8)
    assert phase[np.argmin(np.abs(gain - 1))] == pytest.approx(np.rad2deg(2 * np.arctan(0.4)))
