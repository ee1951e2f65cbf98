"""Digitizer and striker on NI-DAQmx boards, through NI's `nidaqmx` package.

Importing this package is light: `nidaqmx` is loaded when a rig is opened.
"""

from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring, WatchdogWiring

__all__ = ["DaqmxParameters", "TransducerWiring", "WatchdogWiring"]
