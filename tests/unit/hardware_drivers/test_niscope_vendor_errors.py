"""Every error of the vendor's package leaves the driver as one of four classes, its cause attached."""

import sys
import warnings

import pytest

from hardware_drivers.errors import (
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
    UnknownStatusError,
)
from hardware_drivers.niscope.session import import_niscope, open_session
from hardware_drivers.niscope.vendor_errors import CLASS_OF_CODE, find_error_class, translate_errors

niscope = pytest.importorskip("niscope", reason='needs the extra "solimon[niscope]"')


@pytest.mark.parametrize(("code", "kind"), CLASS_OF_CODE.items())
def test_class_of_a_wrapped_code(code, kind):
    assert find_error_class(-1074100000, f"Something happened.\n\nStatus Code: {code}") is kind
    assert find_error_class(code, "") is kind


def test_an_unknown_wrapped_code_stays_unknown():
    assert find_error_class(-1074100000, "Status Code: -123") is UnknownStatusError


@pytest.mark.parametrize("code", CLASS_OF_CODE)
def test_a_driver_error_is_translated_and_kept_as_the_cause(code):
    with (
        pytest.raises(CLASS_OF_CODE[code], match=rf"opening 'X': NI-SCOPE error {code}: told\b") as raised,
        translate_errors(niscope, "opening 'X'"),
    ):
        raise niscope.errors.DriverError(code, "told")
    assert isinstance(raised.value.__cause__, niscope.errors.DriverError)


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (niscope.errors.DriverTooOldError(), ConfigurationError),
        (niscope.errors.UnsupportedConfigurationError(), ConfigurationError),
        (niscope.errors.DriverTooNewError(), ConnectionLostError),
        (ValueError("17 is not a valid VerticalCoupling"), ConnectionLostError),
        (ZeroDivisionError("division by zero"), ConnectionLostError),
        (AssertionError("Number of waveforms"), ConnectionLostError),
    ],
)
def test_nothing_of_the_package_crosses_the_border(error, kind):
    with pytest.raises(kind, match="setting up") as raised, translate_errors(niscope, "setting up"):
        raise error
    assert raised.value.__cause__ is error


def test_an_error_of_ours_passes_unchanged():
    mine = ConfigurationError("ours")
    with pytest.raises(InstrumentError) as raised, translate_errors(niscope, "x"):
        raise mine
    assert raised.value is mine


def test_warnings_of_the_driver_are_kept_and_others_passed_on():
    with warnings.catch_warnings(record=True) as others:
        warnings.simplefilter("always")
        with translate_errors(niscope, "x") as noted:
            for _ in range(2):
                warnings.warn(niscope.errors.DriverWarning(0x3FFA4008, "overload"), stacklevel=1)
            warnings.warn("somebody else's", UserWarning, stacklevel=1)
    assert [str(other.message) for other in others] == ["somebody else's"]
    assert noted == ["Warning 1073365000 occurred. overload"]


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "niscope", None)
    with pytest.raises(ConfigurationError, match=r'pip install "solimon\[niscope\]"'):
        import_niscope()


def test_a_missing_runtime_names_the_package_to_install(monkeypatch):
    nitclk = pytest.importorskip("nitclk")

    def not_there(_handle):
        raise nitclk.errors.DriverNotInstalledError

    monkeypatch.setattr(nitclk, "SessionReference", not_there)
    with pytest.raises(ConfigurationError, match=r"NI-TClk(.|\n)*Install NI-SCOPE with all of its parts"):
        import_niscope()


def test_a_missing_runtime_is_reported_also_next_to_ni_tclk(monkeypatch):
    def not_there(_session, _resource):
        raise niscope.errors.DriverNotInstalledError

    monkeypatch.setattr(niscope.Session, "__init__", not_there)
    with pytest.raises(
        ConfigurationError, match="opening 'PXI1Slot5': the NI-SCOPE runtime is not installed"
    ):
        open_session(niscope, "PXI1Slot5")
