"""Bins of a trend against the plain numbers of their sets."""

import numpy as np
import pytest

from analysis.statistics.bins import join_bins, make_bins

NAN = float("nan")


def bins(**changed):
    """Return bins of six sets: one without any value, one outlier, one missed."""
    columns = {
        "set_index": [0, 1, 2, 3, 4, 7],
        "due_h": [0.5, 1.0, 1.5, 2.0, 2.5, 4.0],
        "values": [[1.0, 5.0], [3.0, NAN], [-2.0, 7.0], [NAN, NAN], [4.0, NAN], [6.0, NAN]],
        "quality": [0, 1, 0, None, 2, 0],
        "missed": [False, False, False, True, False, False],
        "outlier": [None, False, True, None, None, True],
        "outlier_mean_3sd": [None, False, False, None, None, None],
        "in_baseline": [True, False, False, False, False, False],
        "n_alarms": [0, 0, 1, 2, 0, 0],
    }
    return make_bins(**{**columns, **changed})


def test_a_bin_summarizes_its_sets():
    first, last = join_bins(bins(), [0, 4])
    assert (first["first_set"], first["last_set"], first["first_h"], first["last_h"]) == (0, 3, 0.5, 2.0)
    assert (last["first_set"], last["last_set"]) == (4, 7)
    assert first["count"].tolist() == [3, 2]
    assert first["sum"].tolist() == [2.0, 12.0]
    assert (first["minimum"].tolist(), first["maximum"].tolist()) == ([-2.0, 5.0], [3.0, 7.0])
    assert (first["n_sets"], first["n_missed"], first["worst_quality"]) == (3, 1, 1)
    assert (last["n_sets"], last["worst_quality"]) == (2, 2)
    assert (first["n_judged"], first["n_outliers"], first["first_outlier"]) == (2, 1, 2)
    assert (first["n_judged_paper"], first["n_outliers_mean_3sd"]) == (2, 0)
    assert (last["n_judged"], last["n_outliers"], last["first_outlier"]) == (1, 1, 7)
    assert (first["n_in_baseline"], first["n_alarms"], first["first_alarm"]) == (1, 3, 2)
    assert (last["n_alarms"], last["first_alarm"]) == (0, np.inf)


def test_bins_without_values_stay_empty():
    (joined,) = join_bins(bins(values=[[NAN, NAN]] * 6, quality=[None] * 6), [0])
    assert joined["count"].tolist() == [0, 0]
    assert (joined["minimum"] == np.inf).all()
    assert (joined["maximum"] == -np.inf).all()
    assert (joined["n_sets"], joined["worst_quality"]) == (0, -np.inf)


@pytest.mark.parametrize("starts", [[0, 1, 2, 3, 4, 5], [0, 2, 4], [0, 4]])
def test_bins_of_bins_are_bins_of_sets(starts):
    """An outlier is visible at each level."""
    whole = join_bins(bins(), [0])
    assert join_bins(join_bins(bins(), starts), [0]).tobytes() == whole.tobytes()
    assert whole[0]["n_outliers"] == 2
    assert join_bins(bins()[:0], []).size == 0
