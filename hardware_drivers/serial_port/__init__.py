"""Instruments on a serial line: the electrochemical power supply and the climate probe.

`parameters` is light; `line` imports pyserial, and only it does.
"""
