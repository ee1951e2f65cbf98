"""A shot uses the instruments of its position; the safe state is set at all of them."""

from dataclasses import dataclass, field

import pytest

from daq_service.rig.by_position import Digitizers, Strikers
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError, ConnectionLostError
from hardware_drivers.instruments import PersonRequests
from hardware_drivers.measurement import ShotKey


@dataclass(eq=False)
class InstrumentDouble:
    """Striker and digitizer double that records its calls and may fail."""

    name: str
    calls: list[str]
    asking: PersonRequests = field(default_factory=PersonRequests)
    gone: bool = False

    def strike(self, key):
        self.calls.append(f"{self.name} strikes {key.position}")
        self.asking.ask(f"strike {key.position} now")

    def arm(self, key):
        self.calls.append(f"{self.name} arms {key.position}")

    def read(self, timeout_s):
        raise AcquisitionTimeoutError(f"{self.name} heard nothing")

    def make_safe(self):
        self._off("safe")

    def disarm(self):
        self._off("disarmed")

    def _off(self, what):
        self.calls.append(f"{self.name} {what}")
        if self.gone:
            raise ConnectionLostError(f"{self.name} is gone")


def key(position):
    return ShotKey(position=position, set_index=2, shot_index=1)


@pytest.fixture
def calls():
    return []


@pytest.mark.parametrize("gone", ["one", "other", "both"])
def test_every_striker_is_made_safe_once_even_if_another_fails(calls, gone):
    first, second = (InstrumentDouble(name, calls, gone=gone in (name, "both")) for name in ("one", "other"))
    strikers = Strikers({"B": first, "C": second, "D": first}, PersonRequests())
    with pytest.raises(ConnectionLostError):
        strikers.make_safe()
    assert sorted(calls) == ["one safe", "other safe"]


def test_every_digitizer_is_disarmed(calls):
    one, other = InstrumentDouble("one", calls, gone=True), InstrumentDouble("other", calls)
    with pytest.raises(ConnectionLostError, match="one is gone"):
        Digitizers({"B": one, "C": other}, PersonRequests()).disarm()
    assert sorted(calls) == ["one disarmed", "other disarmed"]


def test_the_request_of_a_striker_ends_with_the_read_of_its_shot(calls):
    asking, heard = PersonRequests(), list[tuple[str, ShotKey | None]]()
    asking.listen(lambda text, about: heard.append((text, about)))
    part = InstrumentDouble("one", calls, asking)
    digitizers, strikers = Digitizers({"B": part}, asking), Strikers({"B": part}, asking)
    digitizers.arm(key("B"))
    strikers.strike(key("B"))
    with pytest.raises(AcquisitionTimeoutError):
        digitizers.read(1.0)
    assert heard == [("strike B now", key("B")), ("", key("B"))]
    strikers.strike(key("B"))
    strikers.make_safe()
    assert heard[2:] == [("strike B now", key("B")), ("", key("B"))], "a strike that failed is asked no more"


def test_one_digitizer_is_armed_at_a_time(calls):
    digitizers = Digitizers(
        {"B": InstrumentDouble("one", calls), "C": InstrumentDouble("other", calls)}, PersonRequests()
    )
    with pytest.raises(ConfigurationError, match="not armed"):
        digitizers.read(1.0)
    digitizers.arm(key("B"))
    with pytest.raises(ConfigurationError, match="already armed"):
        digitizers.arm(key("C"))


def test_a_position_without_a_striker_is_rejected(calls):
    strikers = Strikers({"B": InstrumentDouble("one", calls)}, PersonRequests())
    with pytest.raises(
        ConfigurationError, match=r"no striker at position 'C'; there are: B; name one in \[rig"
    ):
        strikers.strike(key("C"))
