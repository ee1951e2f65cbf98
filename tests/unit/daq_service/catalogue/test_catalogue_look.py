"""Reading of a catalogue that a recorder opens at the same time."""

import sqlite3
from contextlib import ExitStack

from support.new_experiment import new_catalogue

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.verification import UnchangedCatalogue


def test_a_recorder_start_during_a_read_is_no_corruption(tmp_path):
    new_catalogue(tmp_path).close()
    with ExitStack() as recorder, UnchangedCatalogue(tmp_path) as look:

        class ChangedConnection:
            """Connection of a file that was opened as immutable and has changed."""

            def execute(self, sql, values):
                recorder.enter_context(open_catalogue(tmp_path, writer=True))
                raise sqlite3.DatabaseError("database disk image is malformed")

        look._connection = ChangedConnection()
        assert look.list_set_keys() == set()
