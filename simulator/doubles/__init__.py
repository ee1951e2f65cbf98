"""Doubles of NI's driver libraries with the twin behind them, below the unmodified vendor packages.

``python -m simulator.doubles`` is one process, the *brain*: boards, tasks, reservations, line levels and
the twin's physics in wall time. In front of it stand doors through which unmodified packages come in::

    nidaqmx.Task -> libnidaqmx.so.1 (built here, `library`) -> wire -> brain
    niscope.Session -> libniscope.so.1 -> wire -> brain (`niscope_brain`)
    nidaqmx.Task(grpc_options=...) -> `grpc_front` -> brain
    `control.DoublesControl` -> `control_server`: faults, unplugging, announcements, the record

Reading order: `entry_points`, `attributes` and `table`, `transport.c` and `c_source` (the C library),
`wire`, `server`, `brain`; behind it `tasks` (states), `analog_input`, `counter_output`, `watchdog`,
`routing` and the entry points (`..._calls`, `..._attributes`); what evolves is `devices`, `reservations`,
`lines`, `strikes`; what it consists of is `description` and `boards`. `control.running_doubles` starts one.

A double proves how a driver talks to NI's API and what it does when calls fail. It cannot prove what
only hardware has: comparators, routing, transfer rates, a real watchdog. See docs/reference/doubles.md.
"""
