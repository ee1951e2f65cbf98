"""What a refusal half-way through making a vendor's object leaves behind: nothing."""

import pytest

from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.errors import ConnectionLostError

pytest.importorskip("nidaqmx")
from nidaqmx.errors import DaqError


def test_a_task_whose_making_fails_half_way_is_cleared():
    notes = []

    class HalfMade:
        """Substitute for NI's Task that is created before its name is refused."""

        def __init__(self, name, grpc_options):
            notes.append("created")
            raise RuntimeError("the driver refused the name")

        def control(self, mode):
            notes.append(mode.name)

        def close(self):
            notes.append("cleared")

    connection = Connection(DaqmxParameters(transducers={"B": TransducerWiring(board_serial="01A2B3C4")}))
    with pytest.raises(ConnectionLostError, match="refused the name"):
        connection._create_task(HalfMade, "creating a task", "solimon")
    assert notes == ["created", "TASK_ABORT", "cleared"]


class System:
    """Substitute for NI's system, whose version is refused with a status."""

    def __init__(self, status):
        self._status = status

    @property
    def driver_version(self):
        raise DaqError("refused", self._status)


@pytest.mark.parametrize(("status", "answer"), [(-200077, "unknown"), (-88710, None)])
def test_a_driver_without_a_version_is_accepted_unless_it_is_gone(monkeypatch, status, answer):
    connection = Connection(DaqmxParameters(transducers={"B": TransducerWiring(board_serial="01A2B3C4")}))
    monkeypatch.setattr(connection, "system", lambda: System(status))
    if answer is None:
        with pytest.raises(ConnectionLostError):
            connection.driver_version()
    else:
        assert connection.driver_version() == answer
