"""Bits flipped in catalogue and history, both cut short: what is read is what was written, or an error."""

from __future__ import annotations

import random
import shutil
from dataclasses import replace
from typing import Any

import pytest
from support.life_of_a_test import lived
from support.table_rows import table_rows

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.corruption import find_catalogue_corruption
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.history import parse_history_lines
from daq_service.catalogue.rows import Row
from daq_service.catalogue.tables import KINDS
from daq_service.errors import StorageError
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue

REBUILT_EVERY = 40
"""Of the damaged catalogues: making one again takes as long as fifty looks."""


@pytest.fixture(scope="module")
def life(tmp_path_factory):
    return lived(tmp_path_factory.mktemp("life"))


def damaged(content, number, seed):
    """Yield contents with one bit changed, nine of ten; others truncated. Zeros, mostly free space, stay."""
    nonzero = [place for place, byte in enumerate(content) if byte]
    chosen = random.Random(seed)
    for count in range(number):
        if count % 10 == 9:
            yield content[: chosen.randrange(len(content))]
        else:
            place = chosen.choice(nonzero)
            yield content[:place] + bytes([content[place] ^ 1 << chosen.randrange(8)]) + content[place + 1 :]


def rows_read(folder, *, writer):
    """Return rows of every kind, or None where corruption is reported."""
    found: dict[type[Row], list[Any] | None] = dict.fromkeys(KINDS)
    try:
        with open_catalogue(folder, writer=True) if writer else open_catalogue(folder) as catalogue:
            for kind in KINDS:
                try:
                    found[kind] = catalogue.rows(kind)
                except StorageError:
                    found[kind] = None
    except StorageError:
        return dict.fromkeys(KINDS)
    return found


def changed_unnamed(folder, content, whole):
    """Return rows of a corrupt file that differ and are not reported as corrupt."""
    path = folder / FILE_NAME
    path.write_bytes(content)  # a start may have repaired other files
    named = {(damage.table, damage.row_id) for damage in find_catalogue_corruption(folder)}
    unnamed = []
    for table, rows in whole.items():
        if {(None, None), (table, None)} & named:
            continue
        found = {row[0]: row for row in table_rows(folder, table)[table]}
        expected = {row[0]: row for row in rows}
        changed = {key for key in {*found, *expected} if found.get(key) != expected.get(key)}
        unnamed += [(table, key) for key in changed if (table, key) not in named]
    return unnamed


@pytest.mark.parametrize("number", [30, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_other_value_is_read_in_silence_and_rebuild_restores_the_rows(life, tmp_path, number):
    whole = rows_read(life.folder, writer=False)
    rows, original = table_rows(life.folder), (life.folder / FILE_NAME).read_bytes()
    reported = 0
    for count, content in enumerate(damaged(original, number, seed=5)):
        folder = tmp_path / f"{count}"
        folder.mkdir()
        (folder / FILE_NAME).write_bytes(content)
        # Readers look at what they ask for alone.
        for kind, found in rows_read(folder, writer=False).items() if count % 4 == 0 else ():
            assert found is None or all(row in (whole[kind] or []) for row in found), count
        started = rows_read(folder, writer=True)
        is_reported = None in started.values()
        assert not (unnamed := changed_unnamed(folder, content, rows)), (count, unnamed)
        assert is_reported or started == whole, count
        reported += is_reported
        if is_reported and count % REBUILT_EVERY == 0:
            line = replace(life, folder=shutil.copytree(life.folder, tmp_path / f"rebuilt-{count}"))
            (line.folder / FILE_NAME).write_bytes(content)
            rebuild_folder_catalogue(line.folder, features_of=line.features_of)
            assert table_rows(line.folder) == rows, count
        shutil.rmtree(folder)
    assert reported > number / 2


@pytest.mark.parametrize("number", [300, pytest.param(3000, marks=pytest.mark.slow)])
def test_the_history_returns_the_written_events_and_reports_missing_ones(life, number):
    original = (life.folder / HISTORY_FILE).read_bytes()
    whole = parse_history_lines(original)
    for count, content in enumerate(damaged(original, number, seed=7)):
        found = parse_history_lines(content)
        missing = 0
        for name in ("events", "commands", "digests"):
            read, written = getattr(found, name), getattr(whole, name)
            missing += len(written) - len(read)
            # A command's earlier state remains where a later line of it is lost.
            assert name == "commands" or read.items() <= written.items(), count
        assert found.experiment in (None, whole.experiment), count
        cut_short = original.startswith(content) or content[:-1] == original[:-1]
        assert found.damage or cut_short or not missing, count
