from __future__ import annotations

import numpy as np
import pytest

from surctl.marine.reproduction.range_test import table_ii


def test_thirty_five_of_thirty_six_percentages_agree():
    table = table_ii()
    assert table.desired.shape == (18,)
    assert table.disagreeing("air").size == 0
    wrong = table.disagreeing("water")
    assert table.desired[wrong] == pytest.approx([0.85])
    assert table.water.measured[wrong] == pytest.approx([0.82])
    assert table.water.printed_percent[wrong] == pytest.approx([3.6])
    assert np.round(table.percent("water")[wrong], 1) == pytest.approx([3.5])


def test_water_column_statistics():
    error = table_ii().errors("water")
    assert error.mean() == pytest.approx(0.0011, abs=5e-5)
    assert error.std(ddof=1) == pytest.approx(0.0164, abs=5e-5)
    assert np.abs(error).max() == pytest.approx(0.03)
