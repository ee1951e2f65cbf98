"""Recorded shots as instruments: an archive of solimon's own, or LabVIEW TDMS files.

`instruments` puts any source of recorded shots behind the Protocols of a rig, `tdms` makes a source
of LabVIEW files (needs the extra ``solimon[tdms]``), `parameters` says what to play back.
"""
