"""Gains in the exported C: ranges, limits of thrust, storage, exchange between steps, and the id of law and gains."""

from __future__ import annotations

import json
import struct
import subprocess
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from surctl.certcheck.bundle import read_manifest
from surctl.errors import InputError
from surctl.export import Bundle, build_controller, write_bundle
from surctl.export.check import trial_steps
from surctl.export.contract import Exportable
from surctl.export.envelope import RANGE, Records
from surctl.export.process import compile_controller
from surctl.export.supplement import gains_id, stored_gains
from surctl.ir import Real
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.export.operating_envelope import gain_orders
from surctl.marine.export.origin import origin_of
from surctl.marine.simulation import law_numbers, load_scenario
from tests.export.closed_form import vehicle
from tests.export.standin import Vector
from tests.tools import need_compiler


@cache
def guarded(real: Real = "float64") -> tuple[Exportable, Bundle, Vector]:
    """A law whose gains are inputs, its bundle, and its tuned gains."""
    mission, law = load_scenario("pool-ahead"), build_law("closed_form")
    p = law_numbers(mission, load_gains("default"), vehicle())
    within = operating_envelope(law, mission, vehicle(), law.gains, tuned=p)
    origin = origin_of(law, vehicle())
    shipped = closed_form(law, real=real)
    return shipped, build_bundle(shipped, law.gains.unpack(p), real=real, envelope=within, origin=origin), p


def run_main(text: str, bundle: Bundle, folder: Path, *, given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    """Compile a main program with the bundle and run it."""
    write_bundle(bundle, folder / "b")
    main = folder / "main.c"
    main.write_text(text)
    code = compile_controller(bundle, folder / "b")
    program = compile_program([main, *code], folder / "main", flags=["-I", str(folder / "b")])
    return subprocess.run([str(program)], input=given, capture_output=True, check=False)


def test_every_tuned_gain_is_in_its_range_and_hostile_ones_are_refused(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, p = guarded()
    within = bundle.envelope
    assert within is not None and within.commands is not None
    assert np.isfinite(within.gains).all() and ((within.gains[:, 0] <= p) & (p <= within.gains[:, 1])).all()
    hostile = {"k_v": 1e9, "thrust_limit": -5.0, "mass": 0.0, "hull": -1.0, "margin": -3.0, "k_r": -1.5}
    P = np.tile(p, (len(hostile) + 2, 1))
    for k, (name, value) in enumerate(hostile.items()):
        P[k, law.gains.slice(name).start] = value
    P[-2] = np.frombuffer(b"\x55" * 8 * len(p))
    records = Records(np.tile(law.initial_state(), (len(P), 1)), np.tile(_ahead(law), (len(P), 1)), P)
    rows = build_controller(law, bundle, tmp_path / "b").run(records, load=np.ones(len(P), dtype=bool))
    assert list(rows.status[:-1]) == [RANGE] * (len(P) - 1) and not rows.tau[:-1].any()
    assert rows.status[-1] >= 0 and rows.tau[-1].any()


def _ahead(law: Exportable) -> Vector:
    u = law.inputs.pack()
    u[law.inputs.slice("eta")] = (1.0, 0.8, -0.15, 0.0)
    u[law.inputs.slice("nu")] = (0.05, 0.05, 0.0, 0.1)
    return u


MAIN = """#include "surctl_closed_form_gains.h"
#include <stdio.h>
#include <string.h>
static unsigned char stored[SURCTL_CLOSED_FORM_GAINS_BYTES + 8];
int main(void)
{
    static surctl_closed_form_state_t s; static surctl_closed_form_gains_t g, kept;
    static surctl_closed_form_gains_set_t set;
    size_t count;
    if (surctl_closed_form_initialize(&s, &g) != 0) { return 1; }
    (void)printf("%08lx\\n", (unsigned long)surctl_closed_form_gains_id(&g));
    if (surctl_closed_form_gains_check(&g) != 0) { return 2; }
    g.k_v = -1.5;
    if (surctl_closed_form_gains_check(&g) != surctl_closed_form_gain_k_v) { return 3; }
    if (surctl_closed_form_gains_save(&g, stored, sizeof stored) != 0) { return 4; }
    g.k_v = 1.25;
    if (surctl_closed_form_gains_save(&g, stored, SURCTL_CLOSED_FORM_GAINS_BYTES - 1) != 0) { return 5; }
    count = surctl_closed_form_gains_save(&g, stored, sizeof stored);
    if (count != SURCTL_CLOSED_FORM_GAINS_BYTES) { return 6; }
    (void)fwrite(stored, 1, count, stdout);
    (void)surctl_closed_form_initialize(&s, &kept);
    g = kept;
    for (size_t at = 0; at < count; ++at) {
        for (int bit = 0; bit < 8; ++bit) {
            stored[at] ^= (unsigned char)(1 << bit);
            if (surctl_closed_form_gains_load(&g, stored, count) == 0) { return 7; }
            if (memcmp(&g, &kept, sizeof g) != 0) { return 8; }
            stored[at] ^= (unsigned char)(1 << bit);
        }
    }
    if (surctl_closed_form_gains_load(&g, stored, count - 1) != SURCTL_CLOSED_FORM_GAINS_LENGTH) { return 9; }
    stored[0] ^= 1;
    if (surctl_closed_form_gains_load(&g, stored, count) != SURCTL_CLOSED_FORM_GAINS_MAGIC) { return 10; }
    stored[0] ^= 1; stored[4] ^= 2;
    if (surctl_closed_form_gains_load(&g, stored, count) != SURCTL_CLOSED_FORM_GAINS_VERSION) { return 11; }
    stored[4] ^= 2; stored[12] ^= 1;
    if (surctl_closed_form_gains_load(&g, stored, count) != SURCTL_CLOSED_FORM_GAINS_LAW) { return 12; }
    stored[12] ^= 1;
    if (surctl_closed_form_gains_begin(&set, &kept) != 0 || set.active.k_v != 1.5) { return 13; }
    if (surctl_closed_form_gains_load(&g, stored, count) != 0 || g.k_v != 1.25) { return 14; }
    if (surctl_closed_form_gains_stage(&set, &g) != 0 || set.active.k_v != 1.5) { return 15; }
    if (surctl_closed_form_gains_stage(&set, &kept) != SURCTL_CLOSED_FORM_GAINS_BUSY) { return 16; }
    if (surctl_closed_form_gains_apply(&set)->k_v != 1.25 || set.pending != 0) { return 17; }
    g.mass[0] = 0.0;
    if (surctl_closed_form_gains_stage(&set, &g) != surctl_closed_form_gain_mass) { return 18; }
    if (surctl_closed_form_gains_apply(&set)->mass[0] != kept.mass[0]) { return 19; }
    if (surctl_closed_form_gains_check(NULL) != -1) { return 20; }
    if (surctl_closed_form_gains_load(NULL, stored, count) != -1) { return 21; }
    return 0;
}
"""


@pytest.mark.parametrize("real", ["float64", "float32"])
def test_gains_are_stored_loaded_and_swapped_and_a_wrong_bit_keeps_the_old_ones(tmp_path: Path, real: Real) -> None:
    need_compiler()
    law, bundle, p = guarded(real)
    text = MAIN if real == "float64" else MAIN.replace("-1.5;", "-1.5f;").replace("= 0.0;", "= 0.0f;")
    done = run_main(text, bundle, tmp_path)
    assert done.returncode == 0
    line, stored = done.stdout.split(b"\n", 1)
    changed = p.copy()
    changed[law.gains.slice("k_v")] = 1.25
    assert stored == stored_gains(law, changed, real)
    assert line.decode() == gains_id(law, p, real) == json.loads(bundle.files["manifest.json"])["gains"]["id"]


def test_stored_nan_or_harmful_gains_with_a_right_crc_are_refused(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, p = guarded()
    cases = b""
    for value in (np.nan, np.inf, -1.0, 1e9):
        bad = p.copy()
        bad[law.gains.slice("k_v")] = value
        cases += stored_gains(law, bad, "float64")
    other = bytearray(stored_gains(law, p, "float64")[:-4])
    other[12:20] = bytes(8)  # the key of another law
    cases += bytes(other) + struct.pack("<I", zlib.crc32(bytes(other)))
    main = """#include "surctl_closed_form_gains.h"
#include <stdio.h>
int main(void)
{
    static unsigned char stored[SURCTL_CLOSED_FORM_GAINS_BYTES];
    static surctl_closed_form_state_t s; static surctl_closed_form_gains_t g;
    (void)surctl_closed_form_initialize(&s, &g);
    while (fread(stored, 1, sizeof stored, stdin) == sizeof stored) {
        (void)printf("%d %g\\n", surctl_closed_form_gains_load(&g, stored, sizeof stored), g.k_v);
    }
    return 0;
}
"""
    done = run_main(main, bundle, tmp_path, given=cases)
    at = law.gains.slice("k_v").start + 1
    assert done.stdout.decode().split("\n") == [*[f"{at} 1.5"] * 4, "-14 1.5", ""]


def test_thrust_is_limited_to_the_vehicles_own_whatever_the_gains_say(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, p = guarded()
    assert bundle.envelope is not None
    loose = replace(bundle.envelope, gains=np.tile([-1e12, 1e12], (len(p), 1)))
    wide = build_bundle(law, law.gains.unpack(p), envelope=loose)
    P = np.tile(p, (2, 1))
    P[0, law.gains.slice("k_v")], P[0, law.gains.slice("thrust_limit")] = 1e9, 5e6
    records = Records(np.tile(law.initial_state(), (2, 1)), np.tile(_ahead(law), (2, 1)), P)
    controller = build_controller(law, wide, tmp_path / "b")
    rows = controller.run(records, load=np.ones(2, dtype=bool))
    assert rows.status[0] & 1 and (np.abs(rows.tau[0]) <= vehicle().thrust_range[1]).all() and rows.tau[0].any()
    python = controller.law.step(records.X[0], records.U[0], P[0])
    assert np.array_equal(python.tau, rows.tau[0]) and python.status == rows.status[0]


def test_a_bundle_with_gains_out_of_range_is_refused() -> None:
    law, bundle, p = guarded()
    with pytest.raises(InputError, match=r"outside the range that the guard accepts, 0\.001 to 20"):
        build_bundle(law, law.gains.unpack(p) | {"k_v": np.array([50.0])}, envelope=bundle.envelope)


def test_the_manifest_binds_law_and_gains() -> None:
    _, bundle, _ = guarded()
    table = json.loads(bundle.files["manifest.json"])
    assert read_manifest(table, bundle.files).wrong == ()
    table["gains"]["id"] = "00000000"
    assert read_manifest(table, bundle.files).wrong == ("the stated id of law and gains is wrong",)


ORDERS = """#include "surctl_closed_form.h"
#include <stdio.h>
int main(void)
{
    static surctl_closed_form_state_t s; static surctl_closed_form_gains_t g, kept;
    static surctl_closed_form_input_t u; static surctl_closed_form_output_t out;
    (void)printf("%lu %lu", (unsigned long)sizeof s, (unsigned long)(sizeof g + sizeof u + sizeof out));
    (void)surctl_closed_form_initialize(&s, &kept);
    if (surctl_closed_form_gains_check(&kept) != 0) { return 1; }
    g = kept; g.walls[0] = kept.walls[1]; g.walls[1] = kept.walls[0];
    if (surctl_closed_form_gains_check(&g) != surctl_closed_form_gain_walls + 1) { return 2; }
    u.sample = 1; u.eta[0] = 1.0; u.eta[1] = 1.0; u.eta[2] = -0.2;
    if (surctl_closed_form_step(&s, &g, &u, &out) != SURCTL_CLOSED_FORM_STATUS_RANGE) { return 3; }
    g = kept; g.cap = 0.5 * kept.cruise;
    if (surctl_closed_form_gains_check(&g) != surctl_closed_form_gain_cap) { return 4; }
    return (surctl_closed_form_step(&s, &kept, &u, &out) < 0) ? 5 : 0;
}
"""


def test_gains_that_contradict_each_other_are_refused_in_c_and_in_python(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, p = guarded()
    done = run_main(ORDERS, bundle, tmp_path)
    assert done.returncode == 0
    state, structs = done.stdout.decode().split()  # with padding
    assert f"RAM: {state} bytes in the state struct" in bundle.files["README.md"]
    assert f"the state unchanged), {structs} bytes in the caller's other structs" in bundle.files["README.md"]
    walls, cap, cruise = (law.gains.slice(name).start for name in ("walls", "cap", "cruise"))
    P = np.tile(p, (3, 1))
    P[1, [walls, walls + 1]] = p[[walls + 1, walls]]
    P[2, cap] = 0.5 * p[cruise]
    assert bundle.envelope is not None and len(bundle.envelope.orders) == 3
    u = law.inputs.pack({"eta": [1.0, 1.0, -0.2, 0.0]})
    records = Records(np.tile(law.initial_state(), (3, 1)), np.tile(u, (3, 1)), P)
    assert list(bundle.envelope.refusals(records)) == [0, RANGE, RANGE]
    with pytest.raises(InputError, match=r"must not be below 0\.\d+"):
        build_bundle(law, law.gains.unpack(P[2]), envelope=bundle.envelope)
    level = P[:1].copy()
    level[0, cap] = level[0, cruise]  # varied by 10 %, half of these would contradict each other
    varied = trial_steps(law, [Records(records.X[:1], records.U[:1], level)], 640, within=bundle.envelope).P
    assert all((varied[:, low] <= varied[:, high]).all() for low, high in bundle.envelope.orders)
    assert gain_orders(law.gains, P[2]) == bundle.envelope.orders[:2]  # what the tuned gains break is not demanded
