"""The waterfall of the service equals the archive, is bounded, with and without tiles."""

import json
import shutil
import struct

import numpy as np
import pytest
from support.filled_folder import filled_folder
from support.served_web import served
from support.stored_files import read_set, set_files

from daq_service.archive.waterfall.cells import extract_anchors, select_accepted_records
from daq_service.archive.waterfall.tiles import TILES_FOLDER
from daq_service.assessment.baseline_lifecycle import renew
from daq_service.assessment.results_in_file import read_set_results
from daq_service.background.tiles import rebuild_tiles
from daq_service.catalogue import SetCommit
from daq_service.catalogue.owner import build_experiment_identity
from daq_service.web.context import find_app_context
from daq_service.web.routes.waterfall import MOST_COLUMNS, MOST_ROWS
from hardware_drivers.measurement import SetKey

N_SETS = 9
MISSED = {4, 5}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=2) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index not in MISSED)
        yield folder


def read(answer):
    """Return header and planes, shape (2, rows, columns)."""
    assert answer.status_code == 200, answer.text
    (length,) = struct.unpack_from("<I", answer.content)
    header = json.loads(answer.content[4 : 4 + length])
    assert (4 + length) % 8 == 0
    planes = np.frombuffer(answer.content, "<f4", offset=4 + length)
    return header, planes.reshape(2, header["rows"], header["columns"])


def expected_extremes(filled, position, header, index):
    """Return the extremes of a set's samples in the columns of a figure, computed from its file."""
    record = read_set(set_files(filled.folder)[index])
    anchors = extract_anchors(read_set_results(filled.catalogue, SetKey(index)))
    rate = header["sample_rate_hz"]
    low = np.full(header["columns"], np.inf)
    high = np.full(header["columns"], -np.inf)
    for taken in select_accepted_records(record, position):
        wave = taken.waveform
        anchor_s = 0.0 if header["align"] == "trigger" else anchors[taken.sequence]
        # Whole samples after the anchor; a millionth of one is the rounding of seconds.
        after = np.floor(np.arange(wave.counts.size) - wave.pretrigger_samples - anchor_s * rate + 1e-6)
        column = np.floor((after / rate - header["first_s"]) / header["cell_s"] + 1e-6).astype(int)
        inside = (column >= 0) & (column < header["columns"])
        np.minimum.at(low, column[inside], wave.volts()[inside])
        np.maximum.at(high, column[inside], wave.volts()[inside])
    planes = np.stack([low, high]).astype(np.float32)
    planes[~np.isfinite(planes)] = np.nan
    return planes


@pytest.mark.parametrize(
    ("position", "query"),
    [
        ("B", ""),
        ("B", "&align=isw"),
        ("B", "&align=isw&columns=33"),
        ("B", "&from_s=2e-5&to_s=9e-5&columns=1000"),
        ("B", "&align=isw&from_s=-2e-5&to_s=9e-5&columns=50"),
        ("A", "&align=first_echo"),
        ("A", "&from_s=0&to_s=4e-6"),
    ],
)
def test_a_waterfall_has_the_extremes_of_the_records(api, filled, position, query):
    header, planes = read(api.get(f"/api/v1/waterfall/{position}?rows=50{query}"))
    stored = [index for index in range(N_SETS) if index not in MISSED]
    assert header["first_set"] == header["last_set"] == stored
    assert header["first_h"] == [filled.due[index].due_h for index in stored]
    for row, index in enumerate(stored):
        np.testing.assert_array_equal(planes[:, row], expected_extremes(filled, position, header, index))
    # A row ends where the next set is due, whether that was taken or not.
    assert header["until_h"] == pytest.approx([filled.due[index + 1].due_h for index in stored])


def test_few_rows_hold_several_sets_and_lose_no_extreme(api, filled):
    fine, fine_planes = read(api.get("/api/v1/waterfall/B?rows=50&columns=100"))
    header, planes = read(api.get("/api/v1/waterfall/B?rows=3&columns=100"))
    assert (header["row_sets"], header["first_set"], header["last_set"]) == (4, [0, 6, 8], [3, 7, 8])
    assert header["n_sets"] == [4, 2, 1]
    for row, sets in enumerate([range(4), (6, 7), (8,)]):
        fine_rows = [fine["first_set"].index(index) for index in sets]
        np.testing.assert_array_equal(planes[0, row], fine_planes[0, fine_rows].min(axis=0))
        np.testing.assert_array_equal(planes[1, row], fine_planes[1, fine_rows].max(axis=0))


def test_a_range_of_hours_is_half_open(api, filled):
    hours = filled.due[2].due_h, filled.due[6].due_h
    header, _ = read(api.get(f"/api/v1/waterfall/B?from_h={hours[0]}&to_h={hours[1]}"))
    assert header["first_set"] == [2, 3]
    empty, planes = read(api.get("/api/v1/waterfall/B?from_h=1000"))
    assert (empty["rows"], planes.size, empty["first_set"]) == (0, 0, [])
    before, _ = read(api.get("/api/v1/waterfall/B?to_h=-5"))
    assert before["rows"] == 0


def test_normalised_rows_have_the_greatest_magnitude_1(api):
    volts, planes = read(api.get("/api/v1/waterfall/C?columns=64"))
    header, normalised = read(api.get("/api/v1/waterfall/C?columns=64&as=normalised"))
    assert (volts["unit"], header["unit"]) == ("V", "1")
    peak = np.abs(planes).max(axis=(0, 2))
    np.testing.assert_array_equal(normalised, planes / peak[None, :, None])


def test_the_difference_is_from_the_mean_of_the_baseline(api, filled):
    # The whole trigger picture has the tiles' own cells, in which means are taken.
    header, difference = read(api.get("/api/v1/waterfall/B?as=difference&columns=1024"))
    assert header["baseline_sets"] == N_SETS - len(MISSED)
    rows = [index for index in range(N_SETS) if index not in MISSED]
    volts = np.stack([expected_extremes(filled, "B", header, index) for index in rows], axis=1)
    mean = volts.astype(np.float64).mean(axis=1, keepdims=True).astype(np.float32)
    np.testing.assert_array_equal(difference, volts - mean)
    echo, planes = read(api.get("/api/v1/waterfall/A?as=difference&rows=50"))
    assert echo["baseline_sets"] == 1
    np.testing.assert_array_equal(planes[:, 0], 0.0)
    filled.catalogue.commit_set(SetCommit(baselines=[renewed_at(filled, "C", N_SETS)]))
    refused = api.get("/api/v1/waterfall/C?as=difference")
    assert refused.status_code == 404, "the present baseline has no set yet"


def renewed_at(filled, position, first_set):
    """Return the row of a new baseline that is collecting."""
    asked = {"first_set": first_set, "author": "ben", "reason": "coupled anew", "utc_ns": filled.epoch_ns}
    return renew(position, filled.settings, None, **asked)[1]


def test_the_json_format_has_the_same_values(api):
    header, planes = read(api.get("/api/v1/waterfall/A?rows=4&columns=16&align=first_echo"))
    answer = api.get("/api/v1/waterfall/A?rows=4&columns=16&align=first_echo&format=json").json()
    assert {name: answer[name] for name in header} == header
    assert header["velocity_m_per_s"] == 5900.0
    np.testing.assert_array_equal(np.array(answer["minimum"], dtype=np.float32), planes[0])
    np.testing.assert_array_equal(np.array(answer["maximum"], dtype=np.float32), planes[1])


def test_an_unchanged_response_is_not_sent_again(api):
    first = api.get("/api/v1/waterfall/B?rows=7")
    again = api.get("/api/v1/waterfall/B?rows=7", headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    other = api.get("/api/v1/waterfall/B?rows=3", headers={"If-None-Match": first.headers["ETag"]})
    assert other.status_code == 200


@pytest.mark.parametrize(
    ("path", "status", "message"),
    [
        ("X", 404, "positions are"),
        ("B?align=first_echo", 422, "Choose trigger or isw"),
        ("A?align=isw", 422, "Choose trigger or first_echo"),
        ("B?from_s=1e-5&to_s=1e-5", 422, "greater than from_s"),
        ("B?from_h=5&to_h=4", 422, "at least from_h"),
        ("B?rows=512&columns=512&format=json", 422, "fewer rows"),
        (f"B?rows={MOST_ROWS + 1}", 422, "rows"),
        (f"B?columns={MOST_COLUMNS + 1}", 422, "columns"),
        ("B?columns=1", 422, "columns"),
        ("B?from_s=nan", 422, "from_s"),
        ("B?as=amperes", 422, "as"),
        ("B?zoom=3", 422, "zoom"),
    ],
)
def test_an_impossible_waterfall_is_rejected_with_a_remedy(api, path, status, message):
    answer = api.get(f"/api/v1/waterfall/{path}")
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert message in answer.text


def test_a_service_that_closes_reads_no_more_records(filled):
    with served(filled.settings, filled.folder) as service, service.client() as client:
        find_app_context(service.app).waterfall.close()
        header, _ = read(client.get("/api/v1/waterfall/B?rows=7"))
    assert (header["rows"], header["pending_sets"]) == (0, N_SETS - len(MISSED))


def test_without_records_there_is_no_waterfall(tmp_path):
    with (
        filled_folder(tmp_path, sets=1) as folder,
        served(folder.settings, folder.folder) as service,
        service.client() as client,
    ):
        answer = client.get("/api/v1/waterfall/B")
    assert (answer.status_code, answer.content) == (204, b"")


def test_tiles_give_the_same_waterfall_and_the_service_writes_none(api, filled):
    queries = ["B?rows=50", "B?rows=3&align=isw", "A?columns=9&align=first_echo", "D?as=difference"]
    before = [read(api.get(f"/api/v1/waterfall/{query}")) for query in queries]
    assert not (filled.folder / TILES_FOLDER).exists()
    files = {SetKey(index): f"sets/{path.name}" for index, path in set_files(filled.folder).items()}
    name = build_experiment_identity(filled.catalogue.read_experiment())
    corruption = rebuild_tiles(
        filled.folder, name, files, lambda key: read_set_results(filled.catalogue, key), lambda done, of: None
    )
    assert corruption == []
    # Another service, which has nothing in its memory and no records.
    sets = filled.folder / "sets"
    sets_aside = filled.folder.with_name("aside")
    shutil.move(sets, sets_aside)
    sets.mkdir()
    shutil.copy(min(sets_aside.iterdir()), sets)  # the first one has the sampling of the records
    try:
        with served(filled.settings, filled.folder) as other, other.client() as client:
            for query, (header, planes) in zip(queries, before, strict=True):
                actual_header, found = read(client.get(f"/api/v1/waterfall/{query}"))
                assert actual_header == header
                np.testing.assert_array_equal(found, planes)
    finally:
        shutil.rmtree(sets)
        shutil.move(sets_aside, sets)
        shutil.rmtree(filled.folder / TILES_FOLDER)
