"""`surctl verify`, `check` and `lint` with files about dynamics."""

from surctl.certcheck import check_file
from tests.cli.process import surctl
from tests.lyapunov.problems import DECAY, MAP, VAN_DER_POL, written


def test_proofs_are_written_and_accepted_and_a_refuted_claim_fails(tmp_path) -> None:
    (tmp_path / "map.toml").write_text(MAP)
    false = MAP.replace('name = "map"', 'name = "fast"').replace("rate = 0.2", "rate = 0.9")
    (tmp_path / "fast.toml").write_text(false)
    done = surctl("verify", "map.toml", "fast.toml", "--out", "proofs", "--json", cwd=tmp_path)
    assert done.status == 1
    verdicts = {claim["claim"]: claim["verdict"] for claim in done.json["claims"]}
    assert verdicts == {"map": "proved", "fast": "refuted"}
    assert done.json["failures"] == ["fast is refuted, not proved"]
    assert done.json["next"] == ["surctl check proofs/map.json"]
    assert sorted(path.name for path in (tmp_path / "proofs").iterdir()) == ["map.json", "map.png"]
    assert check_file(tmp_path / "proofs" / "map.json").accepted


def test_an_expected_refutation_passes(tmp_path) -> None:
    written(tmp_path, MAP, ("rate = 0.2", 'rate = 0.9\nexpected = "refuted"'))
    done = surctl("verify", "problem.toml", cwd=tmp_path)
    assert done.status == 0, done.err
    claim = "where the Lyapunov function V < 1 in the box, V decreases at the rate 0.9 and every "
    assert done.out.startswith(f"refuted  map: the claim that {claim}")
    assert "\n  x+ = 0.5*x + 0.2*y^2\n" in done.out and "\n  equilibrium x = 0, y = 0\n" in done.out


def test_a_mistake_is_one_line(tmp_path) -> None:
    written(tmp_path, VAN_DER_POL, ("- damping*y", "- dampig*y"))
    done = surctl("verify", "problem.toml", cwd=tmp_path)
    assert done.status == 2
    assert "states.y.rate: 'dampig' at column 5 is not known; did you mean 'damping'" in done.complaint
    written(tmp_path, DECAY)
    assert "--cap: does not apply" in surctl("verify", "problem.toml", "--cap", "0.2", cwd=tmp_path).complaint
    assert "key" not in surctl("verify", "problem.toml", "v1-printed", cwd=tmp_path).complaint
    done = surctl("lint", "problem.toml", cwd=tmp_path)
    assert done.status == 0
    assert "surctl verify problem.toml" in done.out


def test_the_statement_is_printed_as_the_checker_reads_it(tmp_path) -> None:
    sides = 'left = "0.30000000000000001*x"\nright = "1"\nconstraints = ["x >= 2"]'
    text = f'kind = "claim"\nname = "c"\n{sides}\n[variables]\n'
    (tmp_path / "c.toml").write_text(f"{text}x = {{ lower = 0, upper = 1 }}\n")
    done = surctl("verify", "c.toml", "--out", ".", cwd=tmp_path)
    assert done.status == 0, done.err
    first, *then = done.out.splitlines()
    assert first.endswith("proved, but vacuous: no point of the box satisfies the constraints")
    assert then[:2] == ["  0.30000000000000001*x <= 1", "  where x in [0.0, 1.0], 2 - x <= 0"]
    checked = surctl("check", "c.json", cwd=tmp_path)
    assert checked.out.startswith("accepted, but vacuous: no point of the box satisfies the constraints")
