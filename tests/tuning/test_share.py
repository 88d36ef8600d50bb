import pytest
from scipy.stats import binom

from surctl.errors import InputError
from surctl.tuning import Share


@pytest.mark.parametrize("runs", [1, 100, 10_000])
def test_without_an_event_the_bound_is_the_closed_form(runs):
    assert Share(0, runs).at_most() == pytest.approx(1 - 0.05 ** (1 / runs), rel=1e-9)


@pytest.mark.parametrize(("count", "runs"), [(1, 10), (7, 1000), (99, 100)])
def test_at_the_bound_so_few_events_have_the_chance_left_over(count, runs):
    assert binom.cdf(count, runs, Share(count, runs).at_most()) == pytest.approx(0.05, rel=1e-9)


def test_if_it_always_happens_nothing_is_ruled_out():
    assert Share(5, 5).at_most() == Share(5, 5).rate == 1.0


@pytest.mark.parametrize(("count", "runs"), [(0, 0), (-1, 5), (6, 5)])
def test_impossible_counts_are_refused(count, runs):
    with pytest.raises(InputError):
        Share(count, runs)
