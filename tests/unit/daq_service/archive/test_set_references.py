"""Names of set files: in the order of time, with the index of the set; those of earlier versions too."""

from pathlib import PurePosixPath

from daq_service.archive.records import build_reference, parse_due_utc_ns, parse_set_keys, to_references
from hardware_drivers.measurement import SetKey
from hardware_drivers.nanoseconds import NS_PER_H

SETS = {
    index: round(hour * NS_PER_H)
    for index, hour in (
        (SetKey(0), 0.5),
        (SetKey(1), 1.0),
        (SetKey(1, 1), 1.1),
        (SetKey(1, 2), 1.1),
        (SetKey(2), 1.5),
    )
}
"""Due times by index, in the order of time."""


def test_the_last_name_is_that_of_the_newest_set_and_has_its_index():
    names = [PurePosixPath(build_reference(index, due)).name for index, due in SETS.items()]
    assert names == sorted(names)
    assert names[2] == "set_000001_19700101T010600Z_001.h5"
    assert list(to_references(names)) == list(SETS)
    assert [parse_due_utc_ns(build_reference(index, due)) for index, due in SETS.items()] == list(
        SETS.values()
    )


def test_a_name_of_an_earlier_version_has_the_whole_index():
    name = "set_10000001_19700101T010600Z.h5"
    assert parse_set_keys([name]) == {SetKey(1, 1)}
    assert parse_due_utc_ns(f"sets/{name}") == SETS[SetKey(1, 1)]
