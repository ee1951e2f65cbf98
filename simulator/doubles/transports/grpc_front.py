"""NI's gRPC device server with the DAQmx double: service ``nidaqmx_grpc.NiDAQmx``, no compiler needed.

Messages and methods come from the stubs that `nidaqmx` ships; which of them are answered, and what their
fields mean, from the same table of entry points as the C library. A method without an entry is
"unimplemented", as on an older server. What differs from the library, here as there:

* A driver's error is a gRPC error of code UNKNOWN with its number in the trailing metadata ``ni-error``
  and its text as details; only a read that got part of its samples answers with `status` in the response.
* Tasks belong to the server and are known by the names of their sessions: they, their reservations and
  lines outlive a client that was killed, until someone clears them or the server ends.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from typing import Any

import numpy as np

from simulator.doubles.errors import DoublesError
from simulator.doubles.vendor_api.entry_points import (
    ENTRY_POINTS,
    HANDLE,
    PACKED,
    EntryPoint,
    Parameter,
    Role,
    Tail,
)
from simulator.doubles.vendor_api.statuses import Status

SERVICE = "nidaqmx_grpc.NiDAQmx"
WORKERS = 64
"""Calls at a time; a hung one keeps its worker."""
TEXT_ROOM = 1 << 16
"""Room offered where a C caller would say how large its buffer is."""

INITIALIZE, ATTACH = 1, 2
"""Of ``SessionInitializationBehavior``; 0 leaves the choice to the server."""

_ATTRIBUTE_METHOD = re.compile(r"(Get|Set)(\w+)Attribute(Bool|Double|Int32|String|UInt32|UInt64)(Array)?\Z")

BrainCall = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
"""Entry point, arguments -> out parameters; raises `Status`."""


def find_unavailability_reason() -> str:
    """Return why gRPC cannot be served here, with the command that installs it; empty if it can."""
    missing = [name for name in ("grpc", "nidaqmx", "google.protobuf") if not _is_installed(name)]
    if not missing:
        return ""
    return f'{", ".join(missing)} not installed: python -m pip install "solimon[grpc]"'


def _is_installed(name: str) -> bool:
    """Return whether a Python module is installed; import its parent package, if any, for that."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


class SessionError(Exception):
    """Error: the name of a session contradicts the client's request."""

    def __init__(self, code: str, text: str) -> None:
        self.code = code
        super().__init__(text)


class Sessions:
    """Tasks of the server by the names of their sessions."""

    def __init__(self) -> None:
        self._handles: dict[str, int] = {}
        self._unnamed = 0
        self._gate = threading.Lock()

    def open(self, name: str, behavior: int, create: Callable[[], int]) -> tuple[str, bool]:
        """Attach to a session by name, or create its task; return its name and whether it is new.

        An empty name creates a session with a unique name. Errors of ``create`` are raised.

        Raises
        ------
        SessionError
            ``behavior`` forbids it: the session to create exists, or that to attach to does not.
        """
        with self._gate:
            if name in self._handles:
                if behavior == INITIALIZE:
                    raise SessionError("ALREADY_EXISTS", f"a session named {name!r} exists already")
                return name, False
            if behavior == ATTACH:
                raise SessionError("FAILED_PRECONDITION", f"there is no session named {name!r} to attach to")
        # Not under the lock: a hung driver call must not keep other sessions from being looked up.
        handle = create()
        with self._gate:
            if not name:
                self._unnamed += 1
                name = f"solimon-double-session-{self._unnamed}"
            self._handles[name] = handle
            return name, True

    def handle(self, name: str) -> int:
        """Return the task handle of a session; 0, which no driver call accepts, if there is none."""
        with self._gate:
            return self._handles.get(name, 0)

    def remove_session(self, name: str) -> None:
        """Remove the name of a session, if it is known; its task is not cleared."""
        with self._gate:
            self._handles.pop(name, None)


def entry_of(method: str) -> EntryPoint | None:
    """Find the C entry point of a gRPC method; None if the double has none.

    A typed attribute method maps to the variadic entry point.
    """
    attribute = _ATTRIBUTE_METHOD.match(method)
    name = f"DAQmx{attribute[1]}{attribute[2]}Attribute" if attribute else f"DAQmx{method}"
    return ENTRY_POINTS.get(name)


def to_arguments(entry: EntryPoint, request: Any, sessions: Sessions) -> dict[str, Any]:
    """Convert the fields of a gRPC request to the arguments of a call by name.

    A session becomes the handle of its task (0 if it is unknown); text buffers have the size `TEXT_ROOM`.
    Raise AttributeError if the request lacks a field.
    """
    arguments: dict[str, Any] = {}
    for parameter in entry.parameters:
        if not parameter.goes_in:
            continue
        if parameter.c_type == HANDLE:
            arguments[parameter.name] = sessions.handle(request.task.name)
        elif _is_text_buffer_size(parameter, entry, request):
            arguments[parameter.name] = TEXT_ROOM
        elif parameter.role is Role.ARRAY:
            numbers = np.asarray(_read_field(request, parameter.name), dtype=PACKED[parameter.c_type])
            arguments[parameter.name], arguments[parameter.size] = numbers, numbers.size
        elif parameter.name not in arguments:
            arguments[parameter.name] = _read_field(request, parameter.name)
    if entry.tail is Tail.SET_ATTRIBUTE:
        arguments["value"] = _read_field(request, "value")
    elif entry.tail is Tail.SET_STATES:
        states = request.power_up_states
        arguments["channel_names"] = "\n".join(state.channel_names for state in states)
        arguments["state"] = np.array([state.state for state in states], dtype=np.int32)
    elif entry.tail is Tail.GET_STATES:
        arguments["channel_names"] = "\n".join(request.channel_name)
    return arguments


def _is_text_buffer_size(parameter: Parameter, entry: EntryPoint, request: Any) -> bool:
    """Return whether a parameter is the size of a text buffer that the gRPC request lacks."""
    sizes = {other.size for other in entry.parameters if other.role is Role.OUT_TEXT}
    return parameter.name in sizes and parameter.name not in request.DESCRIPTOR.fields_by_name


def _read_field(request: Any, name: str) -> Any:
    """Return the value of a request's field, of an enumeration also from its raw number.

    Raise AttributeError if there is no such field.
    """
    fields = request.DESCRIPTOR.fields_by_name
    raw = fields.get(f"{name}_raw")
    if raw is None:
        return getattr(request, name)
    chosen = request.WhichOneof(raw.containing_oneof.name) if raw.containing_oneof else raw.name
    return getattr(request, chosen or raw.name)


def fill_response(entry: EntryPoint, response: Any, values: Mapping[str, Any], status: int) -> None:
    """Write status and output values into the fields of a gRPC response; missing values are left unset.

    Raise KeyError if the states of a power-up call are missing.
    """
    response.status = status
    fields = response.DESCRIPTOR.fields_by_name
    names = [parameter.name for parameter in entry.parameters if parameter.goes_out]
    if entry.tail is Tail.GET_ATTRIBUTE:
        names.append("value")
    elif entry.tail is Tail.GET_STATES:
        response.power_up_states.extend(int(state) for state in values["state"])
    for name in names:
        if name not in values:
            continue
        for field in (name, f"{name}_raw"):
            if field in fields:
                _set_field(response, fields[field], values[name])


def _set_field(response: Any, field: Any, value: Any) -> None:
    """Set a field of a response to a value converted to the field's type; a message field is skipped."""
    if field.type == field.TYPE_MESSAGE:
        return
    if field.is_repeated:
        getattr(response, field.name).extend(np.asarray(value).tolist())
    elif field.type == field.TYPE_BYTES:
        setattr(response, field.name, np.asarray(value).tobytes())
    elif field.type == field.TYPE_BOOL:
        setattr(response, field.name, bool(value))
    else:
        setattr(response, field.name, value)


class GrpcFront:
    """Running server.

    Parameters
    ----------
    call
        The brain, asked in the name of the server: whoever calls, the tasks are its own.
    address
        Where to listen; port 0 takes a free one.
    credentials
        The server's side of TLS, as `grpc.ssl_server_credentials` gives it; None: none.

    Raises
    ------
    DoublesError
        grpc is not installed, or the address is taken.
    """

    def __init__(self, call: BrainCall, address: str = "127.0.0.1:0", credentials: Any = None) -> None:
        reason = find_unavailability_reason()
        if reason:
            raise DoublesError(f"no gRPC front: {reason}")
        import grpc
        from google.protobuf.message_factory import GetMessageClass
        from nidaqmx._stubs import nidaqmx_pb2

        self._grpc = grpc
        self._call = call
        self._sessions = Sessions()
        handlers = {}
        for method in nidaqmx_pb2.DESCRIPTOR.services_by_name["NiDAQmx"].methods:
            entry = entry_of(method.name)
            if entry is None or method.server_streaming or method.client_streaming:
                continue
            request, response = GetMessageClass(method.input_type), GetMessageClass(method.output_type)
            handlers[method.name] = grpc.unary_unary_rpc_method_handler(
                self._create_handler(entry, response),
                request_deserializer=request.FromString,
                response_serializer=response.SerializeToString,
            )
        self.methods = frozenset(handlers)
        self._workers = ThreadPoolExecutor(max_workers=WORKERS, thread_name_prefix="grpc-front")
        self._server = grpc.server(self._workers, options=[("grpc.so_reuseport", 0)])
        self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        try:
            port = (
                self._server.add_insecure_port(address)
                if credentials is None
                else self._server.add_secure_port(address, credentials)
            )
        except RuntimeError as error:
            raise DoublesError(f"no gRPC front at {address}: {error}") from error
        self.address = f"{address.rpartition(':')[0]}:{port}"
        self._server.start()

    def close(self) -> None:
        """Stop the server at once; calls in progress are cancelled."""
        self._server.stop(grace=None)
        self._workers.shutdown(wait=False, cancel_futures=True)

    def _create_handler(self, entry: EntryPoint, response_type: Any) -> Callable[[Any, Any], Any]:
        """Create the handler of one remote procedure, from its entry point and the type of its response."""
        opens_session = any(p.goes_out and p.c_type == HANDLE for p in entry.parameters)

        def answer(request: Any, context: Any) -> Any:
            """Execute the call of a request and return the response.

            An error of driver or session aborts the procedure; a partial read and a warning are responses.
            """
            response = response_type()
            try:
                if opens_session:
                    self._open_session(entry, request, response)
                else:
                    arguments = to_arguments(entry, request, self._sessions)
                    if entry.name == "DAQmxClearTask":
                        # As NI's server does: the name is gone whatever the driver says.
                        self._sessions.remove_session(request.task.name)
                    fill_response(entry, response, self._call(entry.name, arguments), 0)
            except SessionError as error:
                context.abort(self._grpc.StatusCode[error.code], str(error))
            except Status as status:
                partial_read = entry.name.startswith("DAQmxRead") and bool(status.values)
                if status.code < 0 and not partial_read:
                    context.set_trailing_metadata((("ni-error", str(status.code)),))
                    context.abort(self._grpc.StatusCode.UNKNOWN, status.message)
                fill_response(entry, response, status.values, status.code)
            return response

        return answer

    def _open_session(self, entry: EntryPoint, request: Any, response: Any) -> None:
        """Create the task of a session, or attach to that of its name; write the name into the response.

        Raises
        ------
        SessionError, Status
            The session contradicts the request, or the driver refuses the task.
        """

        def create() -> int:
            """Create the task by the driver's call and return its handle."""
            arguments = to_arguments(entry, request, self._sessions)
            return int(self._call(entry.name, arguments)["task"])

        name, is_new = self._sessions.open(request.session_name, request.initialization_behavior, create)
        response.task.name = name
        response.new_session_initialized = is_new
