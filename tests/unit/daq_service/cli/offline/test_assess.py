"""``solimon assess``: foreign tables as input, JSON or text as output."""

import json

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from pyarrow import parquet
from support.healthy_sequences import healthy

from daq_service.cli.main import cli
from daq_service.cli.offline.fleet import describe_fleet
from daq_service.cli.offline.table_file import read_table
from daq_service.errors import UsageError

NAMES = ["tof_pp_s", "tof_ac_s", "amplitude_ratio", "autocorrelation_coefficient", "psw_area_v_s"]
SENSOR_KEYS = {
    *("file", "refused", "features_dropped", "n", "n_eff", "phi_pooled", "tail", "suspects", "named"),
    *("left_out", "limits", "count", "first", "alarm", "rows"),
}
LIMITS = {
    *("paper_mean_3sd", "chi_square", "f_predictive", "f_budget", "phase_one"),
    *("mewma_known", "mewma_textbook", "default"),
}


@pytest.fixture
def vectors():
    x = healthy("independent", 120, np.random.default_rng(0))
    x[90:] += 4.0
    return x


@pytest.fixture
def tables(tmp_path, vectors):
    """Return files of the same sensor in each format."""
    np.save(tmp_path / "sensor.npy", vectors)
    parts = ["healthy" if row < 40 else "test" for row in range(len(vectors))]
    parquet.write_table(
        pa.table({"part": parts, **dict(zip(NAMES, vectors.T, strict=True))}), tmp_path / "sensor.parquet"
    )
    lines = [",".join([part, *map(repr, row)]) for part, row in zip(parts, vectors.tolist(), strict=True)]
    text = "\n".join([",".join(["part", *NAMES]), *lines])
    (tmp_path / "sensor.csv").write_text(text, encoding="utf-8")
    return {path.suffix: path for path in tmp_path.iterdir()}


def run(*arguments):
    return CliRunner().invoke(cli, ["assess", *map(str, arguments)], catch_exceptions=False)


def assessed_sensors(*arguments):
    answer = run(*arguments, "--json")
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.output)["sensors"]


def rejection_message(*arguments):
    with pytest.raises(UsageError) as caught:
        run(*arguments)
    return str(caught.value)


def test_every_format_has_the_same_result(tables):
    (npy,) = assessed_sensors(tables[".npy"], "--baseline-rows", 40)
    (csv_,) = assessed_sensors(tables[".csv"], "--baseline-where", "part=healthy")
    (arrow,) = assessed_sensors(tables[".parquet"], "--baseline-where", "part=healthy")
    assert set(npy) >= SENSOR_KEYS
    assert set(npy["limits"]) == set(npy["count"]) == set(npy["first"]) == LIMITS
    assert csv_.pop("columns_assessed") == arrow.pop("columns_assessed") == NAMES
    assert npy.pop("columns_assessed") == [*"01234"]
    for other in (csv_, arrow):
        assert {**other, "file": ""} == {**npy, "file": ""}
    assert 90 <= npy["alarm"]["rows"][0] < 120
    assert [row["row"] for row in npy["rows"]] == list(range(120))
    assert npy["rows"][39]["chart"] is None
    assert npy["rows"][40]["chart"] > 0.0
    assert npy["alarm"]["rate_guaranteed"] is False
    assert "40 sets" in npy["alarm"]["why"]


def test_the_paper_s_limit_is_shown_with_its_actual_false_alarm_rate(tables):
    lines = run(tables[".npy"], "--baseline-rows", 40).stdout.splitlines()
    experiment_text = {line.split()[0]: line for line in lines if " limit " in line}
    assert "5 % with 48 and 2 % with 200, where 0.27 % was meant" in experiment_text["paper_mean_3sd"]
    assert all("%" not in line for name, line in experiment_text.items() if name != "paper_mean_3sd")


def test_features_baseline_mark_and_rows_can_be_selected(tmp_path, vectors):
    path = tmp_path / "sensor.csv"
    lines = [f"{int(row < 40)},{a},{b},7" for row, (a, b, *_) in enumerate(vectors.tolist())]
    path.write_text("\n".join(["healthy,a,b,c", *lines]), encoding="utf-8")
    (all_of_them,) = assessed_sensors(path, "--baseline-where", "healthy=1", "--no-rows")
    (some,) = assessed_sensors(path, "--baseline-where", "healthy=1", "--features", "b, a", "--no-rows")
    assert all_of_them["features_dropped"] == ["c"]
    assert some["features_dropped"] == []
    assert "rows" not in some
    assert all_of_them["limits"] == pytest.approx(some["limits"])


def test_empty_cells_are_missing_values(tmp_path, vectors):
    path = tmp_path / "sensor.csv"
    lines = [f"{a},{'' if row in (3, 70) else b}" for row, (a, b, *_) in enumerate(vectors.tolist())]
    path.write_text("\n".join(["a,b", *lines]), encoding="utf-8")
    (found,) = assessed_sensors(path, "--baseline-rows", 40)
    assert found["n"] == 39
    assert [item["row"] for item in found["left_out"]] == [3, 70]
    assert found["rows"][70] == {
        "row": 70,
        "distance_squared": None,
        "mewma_textbook": None,
        "mcusum_textbook": None,
        "chart": None,
    }


def test_multiple_processes_assess_many_sensors_identically(tmp_path, tables):
    paths = []
    for k in range(17):
        paths.append(tmp_path / f"{k}.npy")
        np.save(paths[-1], healthy("independent", 60, np.random.default_rng(k)))
    alone = [assessed_sensors(path, "--baseline-rows", 20, "--no-rows")[0] for path in paths[:2]]
    together = assessed_sensors(*paths, "--baseline-rows", 20, "--no-rows")
    assert [item["file"] for item in together] == [str(path) for path in paths]
    assert together[:2] == alone


def test_a_sensor_that_cannot_be_assessed_is_reported_and_the_others_are_assessed(tmp_path, tables):
    np.save(tmp_path / "short.npy", np.random.default_rng(0).standard_normal((14, 5)))
    short, good = assessed_sensors(tmp_path / "short.npy", tables[".npy"], "--baseline-rows", 40)
    assert "14 rows" in short["refused"]
    assert short["limits"] == {}
    assert short["rows"] == []
    assert good["refused"] is None


def test_the_text_output_has_baseline_limits_and_alarms(tables):
    answer = run(tables[".npy"], "--baseline-rows", 40, "--budget", 1)
    assert "baseline   40 sets" in answer.output
    assert "f_predictive" in answer.output
    assert "at rows 9" in answer.output
    assert "1 false alarms per year at 24 sets per day not promised: 40 sets" in answer.output


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", "", "empty"),
        ("a.csv", "a,b", "0 rows"),
        ("a.csv", "a,a\n3,4", "each column must be named once; they are 'a,a'"),
        ("a.csv", "a,b\n3", "row 0 has 1 cells, the first line 2"),
        ("a.csv", "a,b\nx,y", "no column of numbers; it has a, b, with 'x', 'y' in row 0"),
        ("a.csv", 'a,b\n"1,5","2,5"', "with '1,5', '2,5' in row 0: a number has a decimal point"),
        ("a.csv", "a,b\n1,5,2,5", "row 0 has 4 cells, the first line 2: leave a cell empty"),
        ("a.csv", "a,b\n1,2\n# paused, cold, wet\n3,4", "row 1 is a comment, '# paused,cold,wet'; comments"),
        ("a.csv", "a,b\n1,2\n# paused, cold", "row 1 is a comment"),
        ("a.csv", "# a,b", "empty"),
        ("a.csv", "a;b\n12.040,9;1.000,5", "with '12.040,9', '1.000,5' in row 0: a number has"),
        ("a.csv", b"a,b\n1,2\n20 \xb0C,1", "in UTF-8: byte 4 of line 3 is 0xb0; save it as UTF-8"),
        ("a.npy", "no array", "not a .npy file"),
        ("a.parquet", "no table", "not a Parquet file"),
    ],
)
def test_a_file_that_is_no_table_is_rejected_and_the_others_are_assessed(
    tmp_path, tables, name, content, message
):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    bad, good = assessed_sensors(path, tables[".npy"], "--baseline-rows", 40)
    assert message in bad["refused"]
    assert set(bad) == set(good) - {"default_because"}
    assert good["refused"] is None


def test_a_parquet_file_with_a_duplicate_name_is_rejected(tmp_path, vectors):
    parquet.write_table(pa.table(list(vectors[:, :2].T), names=["a", "a"]), tmp_path / "a.parquet")
    (bad,) = assessed_sensors(tmp_path / "a.parquet", "--baseline-rows", 20)
    assert bad["refused"].endswith("a.parquet: each column must be named once; they are 'a,a'")


def test_an_empty_feature_is_named_when_it_prevents_a_baseline(tmp_path, vectors):
    text = "\n".join(["a,b,c", *(f"{a},{b}," for a, b, *_ in vectors.tolist())])
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    (bad,) = assessed_sensors(tmp_path / "a.csv", "--baseline-rows", 40)
    assert bad["refused"].startswith("0 complete rows in the baseline; at least 15 are needed")
    assert bad["refused"].endswith("leave out c, which 0 of 40 have")


@pytest.mark.parametrize("absurd", [1e120, -1e200, 1e308])
@pytest.mark.parametrize("fleet", [[], ["--fleet"]])
def test_an_absurd_value_rejects_only_its_sensor(tmp_path, tables, vectors, absurd, fleet):
    for row in (10, 80):
        cells = vectors.copy()
        cells[row, 2] = absurd
        np.save(tmp_path / f"{row}.npy", cells)
    paths = (tables[".npy"], tmp_path / "10.npy", tmp_path / "80.npy")
    good, before, after = assessed_sensors(*paths, "--baseline-rows", 40, *fleet)
    assert f"2 of row 10 is {absurd:.4g}" in before["refused"]
    assert "correct or empty that cell, or leave 2 out" in before["refused"]
    assert good["refused"] is after["refused"] is None
    assert after["first"]["f_budget"] == 80


def test_a_feature_that_is_the_same_in_most_of_a_baseline_is_refused_by_name(tmp_path, vectors):
    cells = vectors.copy()
    cells[:, 3] = np.arange(len(cells)) % 10 == 7
    np.save(tmp_path / "a.npy", cells)
    (bad,) = assessed_sensors(tmp_path / "a.npy", "--baseline-rows", 40)
    assert bad["refused"].startswith("3 of row 7 is 1, where most of the baseline is within 0 of 0")


def test_a_baseline_without_rows_is_rejected_with_the_available_values(tables):
    (bad,) = assessed_sensors(tables[".csv"], "--baseline-where", "part=good")
    assert bad["refused"].endswith("no row has part=good; there is healthy, test")
    (same,) = assessed_sensors(tables[".csv"], "--baseline-where", " part = Healthy ")
    assert same["n"] == 40


def test_a_baseline_that_leaves_no_row_to_assess_causes_a_warning(tables):
    answer = run(tables[".npy"], "--baseline-rows", 500, "--json")
    (found,) = json.loads(answer.stdout)["sensors"]
    assert found["n"] == 120
    assert found["nothing_judged"].startswith("the last of 120 rows is baseline: no row is assessed")
    assert found["nothing_judged"] in answer.stderr
    assert assessed_sensors(tables[".npy"], "--baseline-rows", 119)[0]["nothing_judged"] is None


@pytest.mark.parametrize(
    "array", [np.zeros(5), np.array([["a"]]), np.zeros((2, 2), complex), np.empty((0, 5))]
)
def test_an_array_that_is_no_table_is_refused(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    (bad,) = assessed_sensors(tmp_path / "a.npy", "--baseline-rows", 20)
    assert "a.npy" in bad["refused"]


@pytest.mark.parametrize(("name", "message"), [("a.txt", "not .txt"), ("a", "one without ending")])
def test_a_file_of_an_unknown_kind_is_a_usage_error(tmp_path, name, message):
    (tmp_path / name).write_text("1", encoding="utf-8")
    assert message in rejection_message(tmp_path / name, "--baseline-rows", 20)


def test_a_missing_file_causes_an_error_after_the_other_results(tmp_path, tables):
    answer = CliRunner().invoke(
        cli, ["assess", str(tmp_path / "none.csv"), str(tables[".npy"]), "--baseline-rows", "40", "--json"]
    )
    absent, good = json.loads(answer.stdout)["sensors"]
    assert "cannot read" in absent["refused"]
    assert good["refused"] is None
    assert isinstance(answer.exception, UsageError)


@pytest.mark.parametrize(
    ("separator", "decimal", "named"),
    [(";", ",", True), ("\t", ".", True), (", ", ".", True), (",", ".", False), (";", ",", False)],
)
def test_csv_of_other_programs_has_the_same_result(tmp_path, tables, vectors, separator, decimal, named):
    (expected,) = assessed_sensors(tables[".npy"], "--baseline-rows", 40)
    lines = [separator.join(repr(v).replace(".", decimal) for v in row) for row in vectors.tolist()]
    text = "\r\n".join([separator.join("01234"), *lines] if named else lines)
    (tmp_path / "other.csv").write_text(text, encoding="utf-8-sig")
    (found,) = assessed_sensors(tmp_path / "other.csv", "--baseline-rows", 40)
    assert {**found, "file": ""} == {**expected, "file": ""}


@pytest.mark.parametrize(
    ("before", "names"),
    [
        ('# Rig 3, April\n# no: "quotes\nx,y,z', ["x", "y", "z"]),
        ("# s, V, V\nx,y,z", ["x", "y", "z"]),
        ("# Rig 3\n# x,y,z", ["x", "y", "z"]),
        ("#,y,z", ["y", "z"]),
        ("# Rig 3", ["0", "1", "2"]),
        ("# 1,2,3", ["0", "1", "2"]),
    ],
)
def test_comments_before_the_rows_are_skipped_and_the_last_one_may_name_the_columns(
    tmp_path, vectors, before, names
):
    path = tmp_path / "a.csv"
    rows = [",".join(map(repr, row[:3])) for row in vectors.tolist()]
    path.write_text("\n".join([before, *rows]), encoding="utf-8")
    table = read_table(path, features=(), baseline_rows=40, baseline_where=None)
    assert list(table.names) == names
    assert table.vectors == pytest.approx(vectors[:, 3 - len(names) : 3])


def test_a_row_label_that_starts_like_a_comment_is_read(tmp_path, vectors):
    path = tmp_path / "a.csv"
    cells = [f"#{row},{a}" if row != 50 else "#50," for row, (a, *_) in enumerate(vectors.tolist())]
    path.write_text("\n".join(["set,a", *cells]), encoding="utf-8")
    (found,) = assessed_sensors(path, "--baseline-rows", 40)
    assert found["refused"] is None
    assert [item["row"] for item in found["left_out"]] == [50]


def test_messages_quote_cells_as_they_are_in_the_file(tmp_path, vectors):
    path = tmp_path / "a.csv"
    rows = [f"12.040,{row:03};{a!r};{0.5 * (row < 40)}" for row, (a, *_) in enumerate(vectors.tolist())]
    path.write_text("\n".join(["hour;a;phase", *rows]).replace(";0.", ";0,"), encoding="utf-8")
    assert "column 'hour' holds '12.040,000', no number" in rejection_message(
        path, "--baseline-rows", 40, "--features", "hour"
    )
    (bad,) = assessed_sensors(path, "--baseline-where", "phase=0.6")
    assert bad["refused"].endswith("no row has phase=0.6; there is 0,5, 0,0")
    for value in ("0.5", "0,5"):
        (found,) = assessed_sensors(path, "--baseline-where", f"phase={value}")
        assert found["n"] == 40


def test_words_for_missing_values_are_recognized_and_unnamed_columns_skipped(tmp_path, vectors):
    cells = {3: "NA", 50: " ", 60: "null", 70: "-inf", 80: "broken"}
    lines = [f"{row},{a},{cells.get(row, b)}," for row, (a, b, *_) in enumerate(vectors.tolist())]
    (tmp_path / "a.csv").write_text("\n".join([",a,b,", *lines]), encoding="utf-8")
    (found,) = assessed_sensors(tmp_path / "a.csv", "--baseline-rows", 40)
    assert found["n"] == 39
    assert found["features_dropped"] == []
    assert [item["row"] for item in found["left_out"]] == [*cells]
    assert "trend" not in [item["kind"] for item in found["named"]]


def test_arguments_without_a_baseline_are_rejected(tables):
    path = tables[".csv"]
    assert "the baseline is not given" in rejection_message(path)
    assert "the baseline is not given" in rejection_message(
        path, "--baseline-rows", 3, "--baseline-where", "a=b"
    )
    assert "COLUMN=VALUE" in rejection_message(path, "--baseline-where", "part")
    assert "no column 'hour'" in rejection_message(path, "--baseline-where", "hour=3")
    assert "no column x; it has part" in rejection_message(path, "--baseline-rows", 20, "--features", "x")
    assert "holds 'healthy', no number" in rejection_message(
        path, "--baseline-rows", 20, "--features", "part"
    )


@pytest.mark.parametrize("budget", ["8766", "1e-9"])
def test_a_budget_that_no_chart_can_keep_is_refused(tables, budget):
    assert f"--budget {float(budget):g} at 24 sets" in rejection_message(
        tables[".csv"], "--baseline-rows", 40, "--budget", budget
    )
    assert assessed_sensors(tables[".npy"], "--baseline-rows", 40, "--budget", "1e-5")[0]["refused"] is None


@pytest.mark.parametrize("option", ["--budget", "--sets-per-day"])
@pytest.mark.parametrize("value", ["nan", "inf", "0"])
def test_invalid_numbers_are_rejected_before_any_file_is_read(option, value):
    answer = CliRunner().invoke(cli, ["assess", "none.csv", "--baseline-rows", "40", option, value])
    assert answer.exit_code == 2
    assert f"Invalid value for '{option}'" in answer.stderr


def test_a_fleet_is_compared_with_its_median_and_the_common_change_is_reported(tmp_path):
    random, paths = np.random.default_rng(8), []
    for k in range(24):
        x = random.standard_normal((300, 5))
        x[200:] += [2.0, 0.0, 0.0, 1.0, 0.0]  # the weather
        if k == 3:
            x[250:, 1] -= 6.0
        paths.append(tmp_path / f"{k:02d}.npy")
        np.save(paths[-1], x if k != 5 else x[:10])
    answer = run(*paths, "--baseline-rows", 150, "--fleet", "--json", "--no-rows")
    fleet = json.loads(answer.stdout)["fleet"]
    assert (fleet["sensors"], fleet["judged"], fleet["beside_the_median"]) == (24, 23, True)
    assert (fleet["fdr_guaranteed"], fleet["why"]) == (True, "")
    (raised,) = fleet["raised"]
    assert raised["file"].endswith("03.npy")
    assert 250 <= raised["row"] < 265
    (cause,) = fleet["shared"]
    assert cause["largest_sd"]["0"] == pytest.approx(2.0, abs=0.3)  # the median of 23 scatters by .26
    assert 200 <= cause["first_row"] < 206
    assert cause["last_row"] == 299
    assert len(fleet["explained"]) >= 20
    output = run(*paths[:7], "--baseline-rows", 150, "--fleet").output
    assert "fleet of 7 sensors, 6 assessed" in output
    assert "fewer than 20 sensors: what they share is not taken out" in output
    every = describe_fleet(fleet)
    assert "inspect    " in every
    assert "all move   rows 20" in every
    assert "by what all share" in every


def test_sensors_of_a_fleet_have_the_same_features(tmp_path):
    for name, features in (("a", 3), ("b", 2)):
        np.save(tmp_path / f"{name}.npy", np.random.default_rng(0).standard_normal((40, features)))
    assert "b.npy has the features 0, 1" in rejection_message(
        tmp_path / "a.npy", tmp_path / "b.npy", "--baseline-rows", 20, "--fleet"
    )


def write_table(path, columns, separator=",", **options):
    """Write a foreign table with cells as text."""
    rows = [separator.join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([separator.join(columns), *rows]), **{"encoding": "utf-8", **options})
    return path


def first_two(vectors):
    return {"a": vectors[:, 0].tolist(), "b": vectors[:, 1].tolist()}


@pytest.mark.parametrize(
    ("separator", "cell"),
    [
        (",", "338.20 us"),
        (",", "338.2us"),
        (",", "50.2%"),
        (",", "\u22121.5"),
        (",", "<5"),
        (",", "'338.2"),
        (",", "(3.2)"),
        (",", "338.2 \u00b1 0.3"),
        (",", '"1,234.5"'),
        (",", "1 234.5"),
        (",", "1.5D-03"),
        (";", "338.201,4"),
        (";", "1'234,5"),
        ("\t", "1,234.5"),
    ],
)
@pytest.mark.parametrize("first", [0, 60])
def test_a_column_of_nearly_numbers_is_refused_with_its_cell_and_the_remedy(
    tmp_path, vectors, separator, cell, first
):
    columns = first_two(vectors)
    columns["b"][first:] = [cell] * (120 - first)
    (bad,) = assessed_sensors(write_table(tmp_path / "a.csv", columns, separator), "--baseline-rows", 40)
    shown = cell.strip('"')
    assert f"a.csv: column 'b' holds {shown!r} in row {first}, nearly a number" in bad["refused"]
    assert "write the number alone" in bad["refused"]
    (found,) = assessed_sensors(tmp_path / "a.csv", "--baseline-rows", 40, "--features", "a")
    assert found["refused"] is None
    if not first:
        message = rejection_message(tmp_path / "a.csv", "--baseline-rows", 40, "--features", "a,b")
        assert message.endswith("in row 0: write the number alone, or choose others")


def test_a_duration_and_texts_of_numbers_in_parquet_are_refused(tmp_path, vectors):
    for column in (pa.array([338_200] * 120, pa.duration("ns")), pa.array(["338.20 us"] * 120)):
        parquet.write_table(pa.table({"a": vectors[:, 0], "b": column}), tmp_path / "a.parquet")
        (bad,) = assessed_sensors(tmp_path / "a.parquet", "--baseline-rows", 40)
        assert "a.parquet: column 'b' holds " in bad["refused"]


def test_thousands_and_decimals_with_the_same_mark_are_refused(tmp_path, vectors):
    columns = first_two(vectors)
    columns["b"][:] = ["338.2"] * 60 + ["1,338"] * 60
    (bad,) = assessed_sensors(write_table(tmp_path / "a.csv", columns, ";"), "--baseline-rows", 40)
    assert "column 'b' holds '1,338' in row 60, nearly a number" in bad["refused"]


LEFT_OUT = {
    "note": (["wet", *["-"] * 119], "most of its cells are not numbers", "wet"),
    "Index": ([7] * 120, "by its name an index, a time or an identifier", "7"),
    "sensor_id": ([7] * 120, "by its name an index, a time or an identifier", "7"),
    "Time [s]": ([7] * 120, "by its name an index, a time or an identifier", "7"),
    "when": (["2026-11-26 13:05"] * 120, "most of its cells are not numbers", "2026-11-26 13:05"),
    "day": (["26.11.2026"] * 120, "by its name an index, a time or an identifier", "26.11.2026"),
    "clock": (["13:05:10"] * 120, "most of its cells are not numbers", "13:05:10"),
    "part": (["0012", "0007"] * 60, "identifiers: integers that start with 0", "0012"),
    "place": (["1_2"] * 120, "most of its cells are not numbers", "1_2"),
    "hash": (["3f2a", "12e3", "b7c0"] * 40, "most of its cells are not numbers", "3f2a"),
    "version": (["1.2.3"] * 120, "most of its cells are not numbers", "1.2.3"),
    "uptime": ([k * k for k in range(120)], "it only rises or only falls, as an index or a time does", "0"),
    "stamp": (
        [1_700_000_000 - k // 2 for k in range(120)],
        "it only rises or only falls, as an index or a time does",
        "1700000000",
    ),
    "": ([3] * 120, "it has no name", "3"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_column_that_is_no_feature_is_left_out_with_its_reason_and_a_cell(tmp_path, vectors, name):
    cells, reason, cell = LEFT_OUT[name]
    path = write_table(tmp_path / "a.csv", {name: cells, **first_two(vectors)})
    (found,) = assessed_sensors(path, "--baseline-rows", 40)
    assert found["columns_assessed"] == ["a", "b"]
    assert found["columns_left_out"] == [{"name": name, "reason": reason, "row": 0, "cell": cell}]
    lines = run(path, "--baseline-rows", 40).output.splitlines()
    assert f"  left out   {name!r}: {reason} ({cell!r} in row 0)" in lines
    assert "  columns    a, b" in lines


def test_a_column_that_is_left_out_can_be_requested(tmp_path, vectors):
    path = write_table(tmp_path / "a.csv", {"hour": range(120), **first_two(vectors)})
    (found,) = assessed_sensors(path, "--baseline-rows", 40, "--features", "hour,a")
    assert found["columns_assessed"] == ["hour", "a"]
    assert found["columns_left_out"] == []


@pytest.mark.parametrize(
    "cell", ["9.9E37", "-9.91E+37", "9.90000000E+37", "1e38", "OVLD", "-OL", "-999", "Inf"]
)
def test_an_instrument_s_overload_is_a_missing_value(tmp_path, vectors, cell):
    columns = first_two(vectors)
    columns["b"][5] = columns["b"][70] = cell
    (found,) = assessed_sensors(write_table(tmp_path / "a.csv", columns), "--baseline-rows", 40)
    assert (found["n"], [item["row"] for item in found["left_out"]]) == (39, [5, 70])


def test_an_overload_in_an_array_is_a_missing_value(tmp_path, vectors):
    vectors[5, 1] = 9.91e37
    np.save(tmp_path / "a.npy", vectors.astype(np.float32))
    (found,) = assessed_sensors(tmp_path / "a.npy", "--baseline-rows", 40)
    assert [item["row"] for item in found["left_out"]] == [5]


def semicolons(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    ("changed", "encoding"),
    [
        (lambda text: text.replace("\n", ",\n") + ",", "utf-8"),  # a separator at each line's end
        (lambda text: "a,b\n" + text.partition("\n")[2].replace("\n", ",\n") + ",", "utf-8"),  # of rows only
        (lambda text: text.replace("a,b", "a,b,,", 1), "utf-8"),  # of names only: rows have fewer cells
        (lambda text: text + "\n,\n,,\n", "utf-8"),  # emptied rows of a spreadsheet
        (lambda text: "sep=;\n" + semicolons(text), "utf-8-sig"),
        (lambda text: text.replace(",", "\t"), "utf-16"),
        (lambda text: text, "utf-16-le"),
        (lambda text: text.replace("a,b", "a,b\ns,V", 1), "utf-8"),  # units
        (lambda text: text.replace("a,b", "a,b\n[s],", 1), "utf-8"),
    ],
)
def test_tables_as_other_programs_write_them_are_read_alike(tmp_path, vectors, changed, encoding):
    plain = write_table(tmp_path / "a.csv", first_two(vectors))
    (tmp_path / "b.csv").write_text(changed(plain.read_text(encoding="utf-8")), encoding=encoding)
    expected, found = assessed_sensors(plain, tmp_path / "b.csv", "--baseline-rows", 40)
    assert {**found, "file": ""} == {**expected, "file": ""}


@pytest.mark.parametrize(
    ("header", "last", "message"),
    [
        ("x,a,b", "Mean,0.1,0.2", "the last row is 'Mean' of the others, not a set: take it out"),
        ("x,a,b", "Total:,0.1,", "the last row is 'Total:' of the others, not a set"),
        ("Rig 3,,\nx,a,b", "wet,0.1,0.2", "row 0 (x,a,b) names columns without a name: keep one such row"),
    ],
)
def test_totals_and_merged_names_are_refused(tmp_path, vectors, header, last, message):
    rows = [f"dry,{a},{b}" for a, b, *_ in vectors.tolist()]
    (tmp_path / "a.csv").write_text("\n".join([header, *rows, last]), encoding="utf-8")
    (bad,) = assessed_sensors(tmp_path / "a.csv", "--baseline-rows", 40)
    assert message in bad["refused"]
