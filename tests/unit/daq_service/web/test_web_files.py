"""Finished files over HTTP: whole, in ranges, only files of the catalogue, only if changed."""

import hashlib
import io

import h5py
import pytest
from support.filled_folder import filled_folder

from hardware_drivers.measurement import SetKey


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data")) as folder:
        for index in range(3):
            folder.add_set(index, stored=index < 2)
        file = next(iter(sorted((folder.folder / "sets").iterdir())))
        folder.catalogue.store_digest(
            SetKey(0), f"sets/{file.name}", hashlib.sha256(file.read_bytes()).hexdigest()
        )
        (folder.folder / "sets" / "set_000009_secret.h5").write_bytes(b"not the catalogue's")
        yield folder


@pytest.fixture(scope="module")
def file(filled):
    return min((filled.folder / "sets").iterdir())


def test_a_file_is_the_one_on_the_disk_as_the_catalogue_names_it(api, file):
    (row, *_) = api.get("/api/v1/sets?position=B").json()["items"]
    answer = api.get(f"/api/v1/files/{row['file'].removeprefix('sets/')}")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-hdf5")
    assert answer.content == file.read_bytes()
    assert hashlib.sha256(answer.content).hexdigest() == row["file_sha256"]
    assert answer.headers["etag"] == f'"{row["file_sha256"]}"'
    with h5py.File(io.BytesIO(answer.content)) as opened:
        assert "B_waveforms" in opened["entry"]
    head = api.head(f"/api/v1/files/{file.name}")
    assert (head.content, int(head.headers["content-length"])) == (b"", len(answer.content))


@pytest.mark.parametrize(
    ("range_header", "part"),
    [("0-7", slice(0, 8)), ("100-", slice(100, None)), ("-64", slice(-64, None)), ("5-5", slice(5, 6))],
)
def test_a_range_has_exact_bytes_also_with_gzip(api, file, range_header, part):
    headers = {"Range": f"bytes={range_header}", "Accept-Encoding": "gzip"}
    answer = api.get(f"/api/v1/files/{file.name}", headers=headers)
    content = file.read_bytes()
    assert (answer.status_code, answer.content) == (206, content[part])
    first = range(len(content))[part][0]
    expected = f"bytes {first}-{first + len(answer.content) - 1}/{len(content)}"
    assert answer.headers["content-range"] == expected


@pytest.mark.parametrize(
    "range_header", ["bytes=9999999-", "bytes=7-3", "bytes=-0", "bytes=x", "lines=1-2", "bytes=0-1,5-6"]
)
def test_an_invalid_range_is_a_problem(api, file, range_header):
    answer = api.get(f"/api/v1/files/{file.name}", headers={"Range": range_header})
    assert (answer.status_code, answer.headers["content-type"]) == (416, "application/problem+json")


def test_an_unchanged_response_is_not_sent_again(api, file):
    path = f"/api/v1/files/{file.name}"
    etag = api.get(path).headers["etag"]
    same = api.get(path, headers={"If-None-Match": etag})
    assert (same.status_code, same.content) == (304, b"")
    other = {"Range": "bytes=0-7", "If-Range": '"another file"'}
    assert api.get(path, headers=other).content == file.read_bytes(), "the range belonged to another file"


@pytest.mark.parametrize(
    "name",
    [
        "set_000009_secret.h5",  # exists, but is not in the catalogue
        "set_000002_20240101T013000Z.h5",  # has no file yet
        "..%2fcatalogue.sqlite",
        "..%2f..%2f..%2fetc%2fpasswd",
        "%2e%2e/catalogue.sqlite",
        "..%5ccatalogue.sqlite",
        "catalogue.sqlite",
        "set_000000_..%2f..%2fcatalogue.h5",
        "set_999999999999999999_x.h5",
        "set_%D9%A3_x.h5",
        "%2fetc%2fpasswd",
        "/etc/passwd",
        "%00",
        "set_000000_20240101T000000Z.h5%00.txt",
        "NUL",
        "CON.h5",
        "C:%5cWindows%5cwin.ini",
        "set_000000_20240101T000000Z.h5:stream",
    ],
)
def test_only_files_of_the_catalogue_are_served(api, name):
    answer = api.get(f"/api/v1/files/{name}")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    "position", ["..%2fcatalogue.sqlite", "..%5cB", "%2fetc", "%00", "NUL", "B%2f..%2fC", "C:"]
)
def test_no_position_escapes_the_folder(api, position):
    for path in (f"sets/{position}/0/waveforms", f"waveforms/{position}/0/0", f"waveforms/live/{position}"):
        answer = api.get(f"/api/v1/{path}")
        assert answer.status_code in {404, 422}, "422: what lies between the slashes is no number"
        assert answer.headers["content-type"] == "application/problem+json"


def test_a_link_to_another_folder_is_not_followed(filled, api, file, tmp_path):
    elsewhere = tmp_path / "elsewhere.h5"
    file.rename(elsewhere)
    try:
        try:
            file.symlink_to(elsewhere)
        except OSError as error:
            pytest.skip(f"no links here: {error}")
        assert api.get(f"/api/v1/files/{file.name}").status_code == 404
    finally:
        file.unlink(missing_ok=True)
        elsewhere.rename(file)
    assert api.get(f"/api/v1/files/{file.name}").status_code == 200
