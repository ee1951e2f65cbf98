"""Every error NI's packages can raise becomes one of the four classes, with cause and remedy."""

from __future__ import annotations

import logging
import warnings

import pytest
from nidaqmx import errors as vendor
from nidaqmx.error_codes import DAQmxErrors

from hardware_drivers.daqmx.translation import (
    CLASS_OF_STATUS,
    find_resource_owner,
    translate_error,
    translate_errors,
)
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    UnknownStatusError,
)

FOUR = {AcquisitionTimeoutError, BusyError, ConnectionLostError, ConfigurationError}


def raised_by_vendor_call(error):
    with pytest.raises(tuple(FOUR)) as caught, translate_errors("testing"):
        raise error
    assert caught.value.__cause__ is error
    assert str(caught.value).startswith("testing: ")
    return caught.value


@pytest.mark.parametrize("kind", [vendor.DaqError, vendor.DaqReadError, vendor.DaqWriteError])
def test_every_status_of_the_package_has_its_class(kind):
    extra = () if kind is vendor.DaqError else (0,)
    for code in DAQmxErrors:
        if code is DAQmxErrors.UNKNOWN:
            continue
        error = raised_by_vendor_call(kind("The driver says no.", code.value, *extra))
        assert type(error) is CLASS_OF_STATUS.get(code.value, UnknownStatusError)
        assert str(code.value) in str(error)
        assert code.name in str(error)


def every_error_class_of_the_package():
    found = set()
    pending = [vendor.Error, vendor.FeatureNotSupportedError]
    while pending:
        kind = pending.pop()
        found.add(kind)
        pending += kind.__subclasses__()
    return found


def made(kind):
    if kind in (vendor.DaqReadError, vendor.DaqWriteError):
        return kind("text", -200284, 0)
    if kind is vendor.DaqError:
        return kind("text", -200284)
    if kind is vendor.RpcError:
        return kind("UNAVAILABLE", "text")
    return kind("text")


def test_every_error_class_of_the_package_is_translated():
    kinds = every_error_class_of_the_package()
    assert {"DaqError", "DaqNotFoundError", "DaqNotSupportedError", "RpcError"} <= {k.__name__ for k in kinds}
    for kind in kinds:
        assert type(raised_by_vendor_call(made(kind))) in FOUR


@pytest.mark.parametrize(
    ("error", "expected", "remedy"),
    [
        (vendor.DaqNotFoundError("x"), ConfigurationError, "install NI's driver"),
        (vendor.DaqNotSupportedError("x"), ConfigurationError, "transport = 'grpc'"),
        (vendor.DaqFunctionNotSupportedError("x"), ConfigurationError, "newer NI-DAQmx"),
        (ValueError("7 is not a valid Level"), ConnectionLostError, "makes no sense"),
    ],
)
def test_errors_without_a_status(error, expected, remedy):
    translated_error = raised_by_vendor_call(error)
    assert type(translated_error) is expected
    assert remedy in str(translated_error)


def test_every_grpc_code_is_translated():
    grpc = pytest.importorskip("grpc", reason="the grpc extra is not installed")
    beyond_cure = {
        "UNAUTHENTICATED", "PERMISSION_DENIED", "UNIMPLEMENTED", "RESOURCE_EXHAUSTED", "INVALID_ARGUMENT",
    }  # fmt: skip
    for code in grpc.StatusCode:
        expected = ConfigurationError if code.name in beyond_cure else ConnectionLostError
        wrapped = raised_by_vendor_call(vendor.RpcError(code, "text"))
        assert type(wrapped) is expected
        assert code.name in str(wrapped)
        bare = type("Bare", (grpc.RpcError,), {"code": lambda _, code=code: code})
        assert type(raised_by_vendor_call(bare())) is expected


def test_an_instrument_error_passes_unchanged():
    original = BusyError("already told")
    with pytest.raises(BusyError) as caught, translate_errors("testing"):
        raise original
    assert caught.value is original
    assert translate_error(original, "testing") is original


def test_a_stop_is_no_vendor_error():
    with pytest.raises(KeyboardInterrupt), translate_errors("testing"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("text", "owner"),
    [
        ("Required Resources in Use by\nTask Name: _unnamedTask<3>\n", "_unnamedTask<3>"),
        ("The resource is reserved.\nReserved by: LabVIEW on BENCH-7.", "LabVIEW on BENCH-7"),
        ("Reserved by another process.\nai is reserved by task T of host BENCH-7.", "task T of host BENCH-7"),
        ("The specified resource is reserved.", ""),
    ],
)
def test_a_busy_resource_names_its_owner(text, owner):
    assert find_resource_owner(text) == owner
    error = raised_by_vendor_call(vendor.DaqError(text, -200022))
    assert (owner or "not named by the driver") in str(error)


def test_a_warning_of_the_driver_is_logged_and_raises_nothing(caplog):
    with caplog.at_level(logging.WARNING), translate_errors("testing"):
        warnings.warn(vendor.DaqWarning("rounded", 200011), stacklevel=1)
    assert "testing" in caplog.text
    assert "rounded" in caplog.text


def test_the_message_is_one_line_with_its_remedy():
    error = raised_by_vendor_call(vendor.DaqError("First.\n\nSecond.\nStatus Code: -200324\n", -200324))
    assert str(error) == (
        "testing: First. Second (DAQmx -200324, DEV_ABSENT_OR_UNAVAILABLE); check power, seating and cable "
        "of board and chassis"
    )
