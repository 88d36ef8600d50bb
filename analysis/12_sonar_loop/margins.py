"""Study 12: margins of the linear loop of a law with sonars about a straight cruise.

    python analysis/12_sonar_loop/margins.py [--quick]

The loop is that of `surctl.marine.verification.sonar_margins`. A row "full" is the law for large signals
(`still` = 0), a row "lag" for small ones.
"""

from __future__ import annotations

import argparse
import sys

from surctl.marine.control import build_law, law_source, load_gains
from surctl.marine.sensing import OwnState
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.sonar_margins import sonar_loop

LAWS: tuple[tuple[str, str, dict[str, float]], ...] = (
    ("guarded", "-", {}), ("calm", "full", {"still": 0.0}), ("calm", "lag", {}),
)  # fmt: skip


def main(words: list[str]) -> int:
    """Print the margins of both laws for two vehicles."""
    parser = argparse.ArgumentParser(prog="margins.py", description="Margins of the linear loop with sonars.")
    parser.add_argument("--quick", action="store_true", help="law calm, one vehicle and filter, few angles")
    quick = parser.parse_args(words).quick
    print("| law | vehicle | band | filter | disk: surge | sway | heave | delay: surge [s] | sway | heave |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for vessel, cruise in (("sur540-flooded", 0.2), ("sur400", 0.15))[: 1 if quick else 2]:
        for name, band, gains in LAWS[1 if quick else 0 :]:
            filters = (("cruise", 0.0), ("full thrust", 5.0 / load_vehicle(vessel)["m11"]))
            for filtered, push in filters[: 1 if quick else 2]:
                vehicle, law = load_vehicle(vessel), build_law(name, sonar=True)
                tuned = load_gains("default").with_own(law_source(name).gains).with_values(gains)
                loop = sonar_loop(law, vehicle, tuned, cruise=cruise, own=OwnState(), manoeuvre=push)
                if not loop.stable():
                    print(
                        f"| `{name}` | `{vessel}` | {band} | {filtered} | unstable, {loop.radius(1.0, 0, (0,)):.5f} |"
                    )
                    continue
                angles = 4 if quick else 19
                which = ((0,), (1,), (2,))
                disks = " | ".join(f"{loop.disk(axes, angles=angles):.2f}" for axes in which)
                delays = " | ".join(f"{loop.delay(axes):.2f}" for axes in which)
                print(f"| `{name}` | `{vessel}` | {band} | {filtered} | {disks} | {delays} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
