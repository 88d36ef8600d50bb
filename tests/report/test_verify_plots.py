import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck.turning_claim import read_claim
from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.report.files import plot_region, save_margins, save_verdicts
from surctl.marine.report.margin_plots import _rim
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.region.nominal import nominal_motion
from surctl.report.evidence import plot_open_boxes
from surctl.verification import decide, falsify
from tests.certcheck.turning_truth import true_rate

CERTIFICATES = Path(__file__).parents[1] / "certcheck"
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default").values


def certificate(name: str) -> dict[str, Any]:
    return json.loads((CERTIFICATES / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["region-cruise-20", "region-cruise-20-lag"])
def test_the_drawn_loop_is_that_of_the_certificate(name: str) -> None:
    whole = certificate(name)
    dynamics, function = nominal_motion(whole)
    claim = read_claim(whole["claim"])
    low, high = dynamics.box[:, :, None]
    xi = low + (high - low) * np.random.default_rng(0).random((4, 50))
    ones = {key: np.ones((50, 2)) for key in ("mass", "linear", "quadratic")}
    ones |= {"term_mass": np.ones(50), "term": np.ones(50)}
    state = xi.T + np.array([0, 0, float(claim.cruise), 0])
    rates = true_rate(claim, ones, state, np.zeros(50), np.zeros(50))
    assert dynamics.evaluate(xi) == pytest.approx(rates.T, abs=1e-12)
    lower = whole["proof"]["P"]
    p = np.array([[lower[max(i, j)][min(i, j)] for j in range(4)] for i in range(4)])
    values = np.asarray(dynamics.compiled(function)(xi, np.zeros((0, 50)))).ravel()
    assert values == pytest.approx(np.einsum("in,ij,jn->n", xi, p, xi), rel=1e-6)


@pytest.mark.usefixtures("blank")
def test_a_picture_needs_a_region() -> None:
    with pytest.raises(InputError, match="not about a region"):
        plot_region({"kind": "interval", "claim": {}})
    assert len(plot_region(certificate("region-cruise-20")).axes) == 6


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
