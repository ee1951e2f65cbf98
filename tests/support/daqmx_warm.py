"""Imported by the server that forks doubles and clients: what every child would otherwise do by itself."""

import nidaqmx  # imported for the children
import nidaqmx.stream_readers
import nidaqmx.system  # noqa: F401

import hardware_drivers.daqmx.instruments  # noqa: F401
import simulator.doubles.__main__  # noqa: F401
from simulator.doubles.daqmx.strikes import Strikes
from support.daqmx_rig import quick_description

Strikes(quick_description(positions="C")).warm_up()
