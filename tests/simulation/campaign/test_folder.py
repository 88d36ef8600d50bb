"""A campaign's folder: what it has is not flown again, and what it was not asked is refused by name."""

from dataclasses import replace

import pytest

from surctl.errors import InputError
from surctl.marine.simulation.campaign import campaign
from surctl.marine.simulation.campaign.campaign import CampaignFolder, run_campaign
from tests.simulation.campaign.test_draws import GAINS, plan

DRAWN = plan("tank-static", law="closed_form", seconds=0.5)
SIZE = 8  # runs of a chunk


def fly(path, drawn, *, runs=5, fresh=False, threads=1):
    folder = CampaignFolder(path, (drawn,))
    folder.prepare(fresh=fresh)
    with folder.store(drawn) as store:
        flown = run_campaign(drawn, runs=runs, store=store, threads=threads, chunk=SIZE)
    folder.write(flown, worst=2)
    return flown


def files(path):
    return {p.relative_to(path): p.read_bytes() for p in path.rglob("*") if p.is_file()}


@pytest.fixture
def flown(monkeypatch):
    """First runs of the chunks that are flown."""
    seen, real = [], campaign._simulate_chunk

    def counting(plan, first, count, threads):
        seen.append((first, count))
        return real(plan, first, count, threads)

    monkeypatch.setattr(campaign, "_simulate_chunk", counting)
    return seen


def test_what_is_there_is_not_flown_again(tmp_path, flown):
    fly(tmp_path, DRAWN, runs=2 * SIZE + 3)
    first = files(tmp_path)
    assert len(flown) == 3
    fly(tmp_path, DRAWN, runs=2 * SIZE + 3)
    assert len(flown) == 3 and files(tmp_path) == first
    (tmp_path / "campaign.chunks" / "tank-static" / "0000001.chunk").unlink()
    fly(tmp_path, DRAWN, runs=2 * SIZE + 3, threads=2)
    assert flown[3:] == [(SIZE, SIZE)] and files(tmp_path) == first
    fly(tmp_path, DRAWN, runs=3 * SIZE)
    assert flown[4:] == [(2 * SIZE, SIZE)]
    fly(tmp_path, DRAWN, runs=3 * SIZE, fresh=True)
    assert len(flown) == 8


def changed(**more):
    return replace(DRAWN, case=replace(DRAWN.case, **more))


OTHERS = {
    "another law": changed(law="paper"),
    "another avoidance": changed(avoidance="printed"),
    "another guidance": changed(guidance="ilos"),
    "another priority mode": changed(mode="filter"),
    "another sensing": changed(sensing="sonar"),
    "another gains": changed(gains=replace(GAINS, name="mine")),
    "other numbers in the gains of this name": changed(gains=GAINS.with_values({"k_v": 1.234})),
    "another scenario": plan("pool-static", seconds=0.5),
    "other numbers in the scenario of this name": plan("tank-static", seconds=0.6),
    "other numbers in the vehicle of this name": changed(vehicle=DRAWN.case.vehicle.with_values({"m11": 99.0})),
    "another first seed": replace(DRAWN, first=1),
}


@pytest.mark.parametrize("what", OTHERS)
def test_another_question_is_refused_by_name(what, tmp_path):
    fly(tmp_path, DRAWN)
    before = files(tmp_path)
    with pytest.raises(InputError, match=f"{what}.*--fresh"):
        CampaignFolder(tmp_path, (OTHERS[what],)).prepare()
    assert files(tmp_path) == before
    CampaignFolder(tmp_path, (OTHERS[what],)).prepare(fresh=True)
    assert not (tmp_path / "campaign.chunks").exists()


def test_starting_afresh_takes_away_what_a_campaign_left_and_nothing_else(tmp_path):
    fly(tmp_path, DRAWN)
    for mine in ("notes.csv", "worst/mine.toml"):
        (tmp_path / mine).write_text("mine")
    CampaignFolder(tmp_path, (OTHERS["another scenario"],)).prepare(fresh=True)
    left = {str(path) for path in files(tmp_path)}
    assert left == {"campaign.json", "notes.csv", "worst/mine.toml"}


def test_more_campaigns_than_were_asked_are_refused(tmp_path):
    fly(tmp_path, DRAWN)
    with pytest.raises(InputError, match="describes 1 campaigns, but 2"):
        CampaignFolder(tmp_path, (DRAWN, OTHERS["another scenario"])).prepare()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"campaigns": 3}', '{"campaigns": [3]}', "\0"])
def test_a_harmed_note_is_told(text, tmp_path):
    (tmp_path / "campaign.json").write_text(text)
    with pytest.raises(InputError, match="does not describe a campaign"):
        CampaignFolder(tmp_path, (DRAWN,)).prepare()


def test_worst_files_of_before_do_not_stay(tmp_path):
    flown = fly(tmp_path, DRAWN)
    assert len(list((tmp_path / "worst").iterdir())) == 2
    CampaignFolder(tmp_path, (DRAWN,)).write(flown, worst=1)
    assert [p.name for p in (tmp_path / "worst").iterdir()] == ["tank-static-worst-1.toml"]


@pytest.mark.parametrize("name", ["../out", "a/b", "*", "..", "two words"])
def test_a_name_leads_to_no_other_folder(name, tmp_path):
    inside = tmp_path / "inside"
    scenario = replace(DRAWN.case.scenario, name=name)
    fly(inside, changed(scenario=scenario), runs=2)
    assert list(tmp_path.iterdir()) == [inside]
    (inside / "other.csv").write_text("mine")
    CampaignFolder(inside, (changed(scenario=scenario),)).prepare(fresh=True)
    assert {str(path) for path in files(inside)} == {"campaign.json", "other.csv"}


def test_a_harmed_chunk_is_flown_again(tmp_path, flown):
    fly(tmp_path, DRAWN)
    first = files(tmp_path)
    chunk = tmp_path / "campaign.chunks" / "tank-static" / "0000000.chunk"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    fly(tmp_path, DRAWN)
    assert len(flown) == 2 and files(tmp_path) == first
