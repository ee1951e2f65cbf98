"""Digitizer and striker on NI-DAQmx boards, through NI's `nidaqmx` package.

Importing this package is light: `nidaqmx` is loaded when a rig is opened.
"""
