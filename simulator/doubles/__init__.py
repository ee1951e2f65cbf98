"""Doubles of NI's driver libraries with the twin behind them, below the unmodified vendor packages.

``python -m simulator.doubles`` is one process, the *brain*: boards, tasks, reservations, line levels and
the twin's physics in wall time. Unmodified packages reach it through `transports`::

    nidaqmx.Task -> libnidaqmx.so.1 (built here, `transports.library`) -> wire -> brain
    niscope.Session -> libniscope.so.1 -> wire -> brain (`niscope`)
    nidaqmx.Task(grpc_options=...) -> `transports.grpc_front` -> brain
    `transports.control.DoublesControl` -> `transports.control_server`: faults, unplugging, the record

Reading order: `vendor_api` (entry points, attributes, statuses, the wire), `transports` (the C library,
the server, gRPC, a test's control), `device_model`; then `daqmx`, `niscope` and `serial`; their components
are in `chassis`. `transports.control.running_doubles` starts one.

A double proves how a driver talks to NI's API and what it does when calls fail. It cannot prove what
only hardware has: comparators, routing, transfer rates, a real watchdog. See docs/reference/doubles.md.
"""
