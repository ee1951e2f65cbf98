"""Pulse-echo unit: an NI-SCOPE digitizer behind a pulser-receiver.

`parameters` needs nothing of NI; everything else imports the `niscope` package only when it opens a
board.
"""
